import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qjrl.studies.workspace.dexterity import (
    DexterityGrid,
    OrientationBins,
    dexterity,
    mean_over_volume,
    orientation_bin,
)
from qjrl.studies.workspace.occupancy import RingGrid

BINS = OrientationBins(tilts=4, azimuths=6, spins=5)
GRID = DexterityGrid(RingGrid(0.1, 2), BINS)


def poses(count: int, position=(0.05, 0.02, 0.03)) -> np.ndarray:
    matrices = Rotation.random(count, rng=np.random.default_rng(1)).as_matrix()
    return np.concatenate([np.broadcast_to(position, (count, 3)), matrices[:, :, 0], matrices[:, :, 1]], axis=1)


def binned(rows: np.ndarray) -> np.ndarray:
    return np.asarray(jax.vmap(lambda row: orientation_bin(row, BINS))(jnp.asarray(rows)))


def test_bins_hold_equal_shares_of_all_rotations():
    counts = np.bincount(binned(poses(120_000)), minlength=BINS.num_bins)
    expected = 120_000 / BINS.num_bins
    chi_squared = ((counts - expected) ** 2 / expected).sum()
    assert chi_squared < BINS.num_bins + 5 * np.sqrt(2 * BINS.num_bins)


def test_an_orientation_keeps_its_bin_when_the_whole_arm_turns_about_its_base_axis():
    rows = poses(500)
    turn = Rotation.from_euler("z", 1.234).as_matrix()
    x, y = rows[:, 3:6], rows[:, 6:9]
    frames = turn @ np.stack([x, y, np.cross(x, y)], axis=2) @ turn.T  # bends turn with the arm, and so do tip frames
    turned = np.concatenate([rows[:, :3] @ turn.T, frames[:, :, 0], frames[:, :, 1]], axis=1)
    assert (binned(turned) == binned(rows)).mean() > 0.995  # all but those on an edge


def test_home_is_in_the_first_band_with_no_spin():
    assert int(orientation_bin(jnp.array([0.0, 0.0, 0.4, 1.0, 1e-4, -1e-3, -1e-4, 1.0, 1e-3]), BINS)) % BINS.spins == 0


def test_a_tip_that_takes_every_orientation_has_share_one_and_an_unreached_cell_none():
    places = np.asarray(jax.vmap(GRID)(jnp.asarray(poses(20_000))))
    found = dexterity(np.bincount(places, minlength=GRID.num_places), GRID)
    assert found.orientations[2, 0] == found.directions[2, 0] == 1.0
    assert np.isnan(found.orientations).sum() == GRID.rings.num_places - 1
    assert mean_over_volume(found.orientations, GRID.rings.volumes, np.ones((4, 2), bool)) == pytest.approx(1 / 16)


def test_one_pose_reaches_one_bin():
    hits = np.zeros(GRID.num_places)
    hits[int(GRID(jnp.asarray(poses(1)[0])))] = 7
    found = dexterity(hits, GRID)
    assert np.nanmax(found.orientations) == pytest.approx(1 / BINS.num_bins)
    assert np.nanmax(found.directions) == pytest.approx(1 / BINS.num_directions)
