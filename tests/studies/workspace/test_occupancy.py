"""Rings, voxels and overlaps against bodies whose volumes are known."""

import jax.numpy as jnp
import numpy as np
import pytest

from qjrl.studies.workspace.occupancy import RingGrid, VoxelGrid, extrapolated, overlap, ring_grid
from qjrl.studies.workspace.voxel_check import check_voxels

RINGS = RingGrid(0.01, 40)
RADIUS = 0.3
BALL = 4.0 / 3.0 * np.pi * RADIUS**3


def ball(rings: RingGrid, radius: float = RADIUS) -> np.ndarray:
    """Rings that a ball about the base touches."""
    near_rho = rings.cell * np.arange(rings.num_cells)
    edges = rings.cell * np.arange(-rings.num_cells, rings.num_cells + 1)
    near_z = np.maximum(np.maximum(edges[:-1], -edges[1:]), 0.0)
    return np.hypot(near_z[:, None], near_rho) < radius


def test_all_rings_together_are_a_cylinder():
    assert RINGS.volume(np.ones(RINGS.shape, bool)) == pytest.approx(np.pi * 0.4**2 * 0.8)


def test_a_place_is_the_ring_around_it():
    position = np.array([0.12, -0.16, -0.055])  # rho = 0.2
    row, column = divmod(int(RINGS(jnp.asarray(position) * (1 + 1e-9))), RINGS.num_cells)
    assert (row, column) == (40 - 6, 20)
    assert RINGS(jnp.array([9.0, 0.0, 9.0])) == RINGS.num_places - 1
    voxels = VoxelGrid(0.1, 4)
    assert int(voxels(jnp.array([0.05, -0.05, 0.25]))) == ((4 + 2) * 8 + 3) * 8 + 4


def test_vanishing_cells_take_away_the_excess_at_the_boundary():
    fine, coarse = RINGS.volume(ball(RINGS)), RINGS.coarser(2).volume(ball(RINGS.coarser(2)))
    assert coarse > fine > 1.05 * BALL
    assert extrapolated(fine, coarse) == pytest.approx(BALL, rel=0.005)


def test_merged_rings_hold_what_their_parts_hold():
    counts = np.random.default_rng(0).integers(0, 5, RINGS.shape)
    merged = RINGS.merged(counts, 4)
    assert merged.shape == RINGS.coarser(4).shape and merged.sum() == counts.sum()
    assert merged[3, 2] == counts[12:16, 8:12].sum()
    np.testing.assert_array_equal(ball(RINGS.coarser(4)), RINGS.merged(ball(RINGS), 4) > 0)
    with pytest.raises(ValueError, match="allowed: a divisor of 40"):
        RINGS.coarser(3)


def test_a_grid_holds_its_reach_and_can_be_made_coarser():
    rings = ring_grid(0.48, 0.005, 4)
    assert rings.num_cells * rings.cell >= 0.48 and rings.num_cells % 4 == 0


def test_overlap_of_a_set_with_itself_is_one_and_with_a_part_is_its_share():
    whole, part = ball(RINGS), ball(RINGS, 0.2)
    same, nested = overlap(whole, whole, RINGS.volumes), overlap(whole, part, RINGS.volumes)
    assert same.of_first == same.of_second == same.jaccard == 1.0
    assert nested.of_second == 1.0
    assert nested.of_first == nested.jaccard == pytest.approx(RINGS.volume(part) / RINGS.volume(whole))
    assert overlap(whole, ~whole, RINGS.volumes).shared == 0.0
    with pytest.raises(ValueError, match="empty set"):
        overlap(whole, np.zeros_like(whole), RINGS.volumes)


def test_voxels_of_a_ball_lie_between_those_inside_and_those_touched_by_its_revolution():
    voxels = VoxelGrid(0.02, 20)
    points = np.random.default_rng(0).uniform(-RADIUS, RADIUS, (600_000, 3))
    points = points[np.linalg.norm(points, axis=1) < RADIUS]
    places = np.asarray(voxels(jnp.asarray(points.T)))
    hits = np.bincount(places, minlength=voxels.num_places)
    check = check_voxels(hits, voxels, ball(RINGS), RINGS)
    assert check.inside < BALL < check.hit < check.touched
    assert check.hit_outside == 0 and check.missed_inside == 0
    shifted = np.roll(hits.reshape(40, 40, 40), 3, axis=2).ravel()  # no longer a body of revolution
    assert check_voxels(shifted, voxels, ball(RINGS), RINGS).hit_outside > 100
