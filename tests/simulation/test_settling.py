import dataclasses
import math

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from arms import altered, arm_named, over_rows, random_bends
from mujoco import batch

from qjrl.config import conf_folder, shipped
from qjrl.robot import build_mjcf, cable_lengths, joint_positions, robot_from_mapping, strand_commands
from qjrl.simulation import SettleConfig, settle
from qjrl.simulation.mujoco_settle import settle_mujoco
from qjrl.simulation.sampling import sample_rows
from qjrl.simulation.settling import nominal_problem

ARM = arm_named("qj_22")


@pytest.fixture(scope="module")
def settled():
    """200 commands over the feasible space of the paper's arm, and what they settle at."""
    arm = arm_named("qj_2222")
    lengths = over_rows(cable_lengths, arm, random_bends(arm, 200, seed=1))
    return arm, lengths, settle(arm, lengths)


def test_200_commands_all_come_to_rest_on_the_constraint_manifold(settled):
    _, _, result = settled
    assert result.converged.all()
    assert result.equality_error.max() < 1e-4
    assert result.speed.max() < SettleConfig().speed_tolerance
    assert result.steps.max() < SettleConfig().max_steps
    assert result.pose.shape == (200, 9)
    assert result.bends.shape == (200, 4, 2)
    assert result.joint_positions.shape == (200, 40)
    assert result.strand_tension.shape == (200, 16)
    assert {array.dtype for array in (result.pose, result.bends, result.strand_tension)} == {np.dtype(np.float64)}


def test_stepped_two_seconds_further_with_the_robot_s_own_damping_they_stay_where_they_are(settled):
    arm, lengths, result = settled
    simulations = batch.Batch(mujoco.MjModel.from_xml_string(build_mjcf(arm)), len(lengths))
    tip = simulations.site("tip").xpos
    simulations.qpos[:] = result.joint_positions
    simulations.ctrl[:] = over_rows(strand_commands, arm, lengths)
    simulations.step(nstep=500)
    simulations.forward()
    assert 1e3 * np.linalg.norm(tip - result.pose[:, :3], axis=1).max() < 0.02


def test_strands_pull_or_are_slack_and_motors_hold_the_difference(settled):
    arm, _, result = settled
    assert result.strand_tension.min() >= 0.0
    assert result.strand_tension.max() < arm.config.strands.strength
    np.testing.assert_array_equal(result.is_slack, result.strand_tension < 0.01)
    assert result.motor_force.shape == (200, 8)
    np.testing.assert_array_equal(result.motor_force[:, 2], result.strand_tension[:, 4] - result.strand_tension[:, 5])
    assert np.abs(result.motor_force).max() < arm.config.motors.force


def test_a_row_does_not_depend_on_threads_pool_or_neighbours():
    lengths = over_rows(cable_lengths, ARM, random_bends(ARM, 12, seed=2))
    problem = nominal_problem(ARM, lengths)
    reference = settle_mujoco(ARM, problem, SettleConfig(num_threads=2), int)
    turned = dataclasses.replace(problem, **{name: rows[::-1] for name, rows in vars(problem).items()})
    alone = settle_mujoco(ARM, problem, SettleConfig(batch_size=1, num_threads=1), int)
    crowded = settle_mujoco(ARM, turned, SettleConfig(batch_size=5, num_threads=3), int)
    for name, rows in vars(reference).items():
        np.testing.assert_array_equal(getattr(alone, name), rows, err_msg=name)
        np.testing.assert_array_equal(getattr(crowded, name)[::-1], rows, err_msg=name)


def test_at_home_the_arm_stands_straight_with_its_pretension():
    result = settle(ARM, np.zeros((1, 4)))
    np.testing.assert_allclose(result.pose[0, :2], 0.0, atol=1e-9)
    np.testing.assert_allclose(result.bends, 0.0, atol=1e-9)
    np.testing.assert_allclose(result.strand_tension, 15.0, atol=0.01)


def test_progress_counts_every_row_once():
    counts = []
    settle(ARM, np.zeros((5, 4)), config=SettleConfig(batch_size=2), advance=counts.append)
    assert sum(counts) == 5


def test_no_rows_are_no_work():
    result = settle(ARM, np.zeros((0, 4)))
    assert result.pose.shape == (0, 9)
    assert result.motor_force.shape == (0, 4)


def test_what_has_no_time_to_rest_is_flagged():
    lengths = over_rows(cable_lengths, ARM, random_bends(ARM, 6, seed=3))
    config = SettleConfig(max_time=0.1)
    result = settle(ARM, lengths, config=config)
    assert not result.converged.any()
    np.testing.assert_array_equal(result.steps, config.max_steps)


def test_what_diverges_is_flagged_and_leaves_its_neighbours_alone():
    """Strands a thousand times as stiff cannot be integrated at this time step."""
    wild = robot_from_mapping(altered("qj_22", strands__stiffness=2e7))
    lengths = over_rows(cable_lengths, wild, random_bends(wild, 4, seed=3))
    result = settle(wild, lengths, config=SettleConfig(damping_scale=10.0, max_time=1.0))
    assert not result.converged.any()


@pytest.mark.parametrize(
    ("lengths", "words"),
    [
        (np.zeros(4), r"got shape \(4,\), allowed: \(n, 4\)"),
        (np.zeros((3, 8)), r"got shape \(3, 8\), allowed: \(n, 4\)"),
        (np.array([[0, 0, 0, np.nan]]), "non-finite"),
        (np.array([[0, 0, 0, np.inf]]), "non-finite"),
    ],
)
def test_wrong_lengths_are_refused(lengths, words):
    with pytest.raises(ValueError, match=f"cable_lengths: got.*{words}|cable_lengths: {words}"):
        settle(ARM, lengths)


def test_an_unknown_backend_is_refused():
    with pytest.raises(ValueError, match="backend: got 'bullet', allowed: mujoco, mjx, mjx-warp"):
        settle(ARM, np.zeros((1, 4)), backend="bullet")


def test_the_shipped_files_name_their_engine_and_change_nothing_else():
    for path in (conf_folder() / "simulation").glob("*.yaml"):
        engine = dataclasses.replace(SettleConfig(), backend=path.stem.replace("_", "-"))
        assert shipped(SettleConfig, f"simulation/{path.stem}") == engine


def test_the_rest_speed_shrinks_with_what_damping_adds():
    for scale in (None, 1.0, 0.5):
        assert SettleConfig(damping_scale=scale).rest_speed == 1e-4
    assert math.isclose(SettleConfig(damping_scale=10.0).rest_speed, 1e-5)


def test_holding_longer_than_there_is_time_is_refused():
    with pytest.raises(ValueError, match=r"hold_time: got 2\.0, allowed: less than max_time = 1\.0"):
        SettleConfig(hold_time=2.0, max_time=1.0)


@pytest.mark.slow
def test_1000_commands_rest_where_a_fixed_long_settle_from_home_with_the_robot_s_own_physics_ends():
    arm = arm_named("qj_2222")
    rows = sample_rows(arm, SettleConfig(), seed=3, start=0, count=1000)
    simulations = batch.Batch(mujoco.MjModel.from_xml_string(build_mjcf(arm)), 1000)
    tip = simulations.site("tip").xpos
    simulations.qpos[:] = np.asarray(joint_positions(arm, jnp.zeros((arm.num_segments, 2))))
    simulations.ctrl[:] = over_rows(strand_commands, arm, rows["cable_lengths"])
    simulations.step(nstep=1200)  # 4.8 s; after 1.6 s the worst is still 8 mm away
    simulations.forward()
    assert rows["converged"].all()
    off = 1e3 * np.linalg.norm(tip - rows["pose"][:, :3], axis=1)
    assert np.sum(off > 0.02) <= 1 and off.max() < 0.03  # one creeps on below the rest speed: 0.027 mm, the next 0.006


def test_settings_made_in_python_are_held_against_their_ranges():
    for field, value in (("timestep", -1.0), ("timestep", 1.0), ("max_time", 0.0), ("batch_size", 0)):
        with pytest.raises(ValueError, match=rf"SettleConfig\.{field}: got .*allowed: "):
            dataclasses.replace(SettleConfig(), **{field: value})
