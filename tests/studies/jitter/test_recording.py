"""Commands played on both cable models in C MuJoCo."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from arms import over_rows, random_bends

from qjrl.robot import cable_lengths, forward_kinematics, joint_positions, load_robot, strand_commands
from qjrl.robot.plant import PhysicalParameters
from qjrl.simulation.stepping import MujocoStepper
from qjrl.studies.jitter.cable_models import Play, StrandLimits
from qjrl.studies.jitter.mujoco_recording import record_mujoco

PERIODS = 100


@pytest.fixture(scope="module")
def arm():
    return load_robot("qj_22")


@pytest.fixture(scope="module")
def bends(arm):
    return random_bends(arm, 1, seed=4, share=0.4)


@pytest.fixture(scope="module")
def play(arm, bends):
    """One command on three ranges: 0.01, 0.1 and 1 mm to each side."""
    share = np.minimum(np.arange(1, PERIODS + 1) / 25.0, 1.0)
    lengths = share[:, None, None] * np.repeat(over_rows(cable_lengths, arm, bends), 3, axis=0)
    limits = StrandLimits(np.array([1e-5, 1e-4, 1e-3]), np.full(3, 0.008), np.full((3, 2), 0.9999))
    return Play(arm, "limits", lengths, limits, np.full(3, 1e-10), iterations=20)


def test_limits_hold_the_nominal_pose_the_better_the_narrower_they_are(arm, bends, play):
    recording = record_mujoco(play)
    off = np.linalg.norm(recording.tip - over_rows(forward_kinematics, arm, bends)[:, :3], axis=1)
    assert off[0] < 2e-4 and off[0] < off[1] < off[2] < 0.05
    assert recording.joint_velocities.shape == (3, 5 * PERIODS, 20)
    assert np.abs(recording.joint_velocities[:2, -25:]).mean() < 1e-6  # C rests


def test_a_force_on_the_tip_moves_it_its_own_way_and_none_moves_nothing(play):
    without = record_mujoco(play)
    np.testing.assert_array_equal(record_mujoco(play, np.zeros((3, 3))).tip, without.tip)
    there, back = (record_mujoco(play, np.tile([sign, 0.0, 0.0], (3, 1))).tip - without.tip for sign in (1.0, -1.0))
    assert (there[:, 0] > 0.0).all() and (back[:, 0] < 0.0).all()
    assert np.all(np.diff(there[:, 0]) > 0.0)  # the wider, the softer


def test_servos_move_as_the_stepper_moves_them(arm, play):
    recording = record_mujoco(dataclasses.replace(play, cables="servos"))
    stepper = MujocoStepper(arm, 3)
    home = np.asarray(joint_positions(arm, jnp.zeros((2, 2))))
    start = np.asarray(strand_commands(arm, jnp.zeros(arm.num_cables)))
    stepper.reset(np.arange(3), home, start, PhysicalParameters.nominal(arm, 3))
    for period, lengths in enumerate(play.cable_lengths[:30]):
        stepper.step(over_rows(strand_commands, arm, lengths), play.steps_per_period)
        found = recording.joint_velocities[:, (period + 1) * play.steps_per_period - 1]
        np.testing.assert_allclose(found, stepper.read().joint_velocities, atol=1e-6)


def test_a_simulation_that_diverges_is_no_number_from_there_on(play):
    wild = dataclasses.replace(play, iterations=1, cable_lengths=play.cable_lengths + 100.0)
    recording = record_mujoco(wild)
    assert np.isnan(recording.joint_velocities[:, -1]).all() and np.isnan(recording.tip).all()
