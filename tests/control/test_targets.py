import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named

from qjrl.control.targets import TARGET_SETS, TargetConfig, draw_configurations, target_poses
from qjrl.robot import forward_kinematics
from qjrl.robot.quaternion_arm.sampling import bends_at_distance, bends_from_unit_cube

ARMS = ["qj_2222", "qj_huang_4332"]


def tip_distances(arm, bends):
    """How far the tips are from the home tip (n,) [m]."""
    home = forward_kinematics(arm, jnp.zeros((arm.num_segments, 2)))[:3]
    return np.linalg.norm(target_poses(arm, bends)[:, :3] - np.asarray(home), axis=1)


def angles(bends):
    return 2.0 * np.arcsin(np.linalg.norm(bends, axis=2))


@pytest.mark.parametrize("target_set", TARGET_SETS)
def test_a_row_depends_on_its_number_and_not_on_how_many_there_are(target_set):
    arm = arm_named("qj_22")
    many = draw_configurations(arm, target_set, 9, seed=4)
    np.testing.assert_array_equal(draw_configurations(arm, target_set, 5, seed=4), many[:5])
    assert np.abs(draw_configurations(arm, target_set, 9, seed=5) - many).min(axis=(1, 2)).max() > 0
    assert len(np.unique(many.round(12), axis=0)) == 9


@pytest.mark.parametrize("target_set", TARGET_SETS)
@pytest.mark.parametrize("name", ARMS)
def test_every_target_is_within_the_joints_limits(name, target_set):
    arm = arm_named(name)
    found = angles(draw_configurations(arm, target_set, 400, seed=0))
    assert found.max() <= float(arm.bend_limit) + 1e-9


def test_uniform_targets_are_uniform_in_angle_and_direction():
    arm, count = arm_named("qj_2222"), 2000
    bends = draw_configurations(arm, "uniform", count, seed=0)
    shares = angles(bends) / float(arm.bend_limit)
    turns = np.arctan2(bends[..., 1], bends[..., 0]) / (2 * np.pi) + 0.5
    for places in (shares, turns):
        for segment in range(arm.num_segments):
            np.testing.assert_allclose(np.histogram(places[:, segment], 4, (0, 1))[0] / count, 0.25, atol=0.045)


def test_targets_near_home_follow_the_papers_law():
    """d = d_max u^3, so (d / d_max)^(1/3) is uniform and half of the tips are within d_max / 8."""
    arm, count, largest = arm_named("qj_2222"), 2000, 0.3
    distances = tip_distances(arm, draw_configurations(arm, "near_home", count, 0, TargetConfig(largest)))
    assert distances.max() <= largest + 1e-6
    # Some directions cannot reach as far as drawn: the largest distances are a little rarer.
    np.testing.assert_allclose(np.histogram(np.cbrt(distances / largest), 4, (0, 1))[0] / count, 0.25, atol=0.045)
    assert np.mean(distances < largest / 8) == pytest.approx(0.5, abs=0.04)


@pytest.mark.parametrize("name", ARMS)
def test_bends_at_a_distance_have_their_tip_there_where_that_is_feasible(name):
    arm = arm_named(name)
    distances = np.repeat([0.0, 1e-4, 0.037, 0.1], 64)
    keys = jax.random.split(jax.random.key(7), len(distances))
    bends = jax.jit(jax.vmap(lambda key, distance: bends_at_distance(arm, key, distance)))(keys, distances)
    found, at_limit = tip_distances(arm, bends), angles(bends).max(axis=1) > float(arm.bend_limit) - 1e-6
    np.testing.assert_allclose(found[~at_limit], distances[~at_limit], atol=1e-6)
    assert np.all(found[at_limit] < distances[at_limit] + 1e-6) and np.mean(at_limit) < 0.05


def test_a_distance_beyond_reach_gives_the_longest_feasible_bends():
    arm = arm_named("qj_22")
    bends = bends_at_distance(arm, jax.random.key(0), jnp.asarray(99.0))
    assert float(angles(np.asarray(bends)[None]).max()) == pytest.approx(float(arm.bend_limit), abs=1e-9)


def test_bends_of_the_unit_cube_cover_the_disc_evenly():
    arm = arm_named("qj_22")
    grid = np.random.default_rng(0).uniform(size=(4000, 4))
    bends = np.asarray(jax.vmap(lambda row: bends_from_unit_cube(arm, row))(jnp.asarray(grid)))
    radius = np.linalg.norm(bends, axis=2) / np.sin(float(arm.bend_limit) / 2)
    assert radius.max() <= 1 + 1e-12
    assert np.mean(radius < 0.5) == pytest.approx(0.25, abs=0.02)
    assert np.abs(bends.mean(axis=0)).max() < 0.02
    corner = bends_from_unit_cube(arm, jnp.array([0.25, 0.25, 1.0, 0.0]))
    largest = np.sin(float(arm.bend_limit) / 2)
    np.testing.assert_allclose(corner, [[0.0, largest / 2], [largest, 0.0]], atol=1e-12)


def test_an_unknown_set_is_refused_with_those_that_exist():
    with pytest.raises(ValueError, match="target_set: got 'far', allowed: uniform, near_home"):
        draw_configurations(arm_named("qj_22"), "far", 3, 0)
