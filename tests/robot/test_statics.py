"""Equilibria and their slopes against arms that come to rest in time."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named

from qjrl.robot import cable_lengths, configuration_from_joint_positions, equilibrium, joint_positions, strand_commands
from qjrl.simulation.minimal_stepping import MinimalStepper
from qjrl.simulation.stepping import MujocoStepper, PhysicalParameters

ARM = arm_named("qj_22")
BENDS = jnp.array([[0.25, 0.1], [-0.2, 0.3]])
LENGTHS = cable_lengths(ARM, BENDS)
GAIN, TILT, PULL = 0.02, 0.01, 0.5
FOUND = equilibrium(ARM, LENGTHS)


def rested(make, commands, **changed) -> np.ndarray:
    """Bends after 4 s of holding rest lengths (n, strands) [m], without friction."""
    count = len(commands)
    parameters = dataclasses.replace(PhysicalParameters.nominal(ARM, count), strand_friction=np.zeros(count), **changed)
    stepper = make(ARM, count, num_threads=1)
    stepper.reset(np.arange(count), np.asarray(joint_positions(ARM, BENDS)), commands, parameters)
    stepper.step(commands, round(4.0 / stepper.timestep))
    positions = stepper.read().joint_positions
    return np.array([configuration_from_joint_positions(ARM, jnp.asarray(row)) for row in positions])


def held(count: int) -> np.ndarray:
    return np.tile(np.asarray(strand_commands(ARM, LENGTHS)), (count, 1))


@pytest.fixture(scope="module")
def shifted():
    """Bends moved by both signs of gain, tilt about x, tilt about y and one strand's pull: half differences."""
    commands = held(8)
    commands[6:, 3] -= np.array([PULL, -PULL]) / float(ARM.strand_stiffness)
    gain, tilt = np.ones(8), np.zeros((8, 2))
    gain[:2] = np.exp([GAIN, -GAIN])
    tilt[2:4, 0], tilt[4:6, 1] = [TILT, -TILT], [TILT, -TILT]
    found = rested(MinimalStepper, commands, gain_scale=gain, tilt=tilt)
    return (found[::2] - found[1::2]) / 2.0


def test_it_is_where_mujoco_rests():
    assert np.abs(rested(MujocoStepper, held(1))[0] - FOUND.bends).max() < 2e-5
    assert np.abs(BENDS - FOUND.bends).max() > 1e-3  # which is not where a perfect arm would be


def test_slopes_are_those_of_arms_that_differ(shifted):
    expected = [GAIN * FOUND.by_gain, *(TILT * np.moveaxis(FOUND.by_tilt, 2, 0)), PULL * FOUND.by_pull[..., 3]]
    for predicted, measured in zip(expected, shifted, strict=True):
        np.testing.assert_allclose(measured, predicted, rtol=0.02, atol=2e-6)


def test_the_slope_by_gain_is_smooth_in_single_precision():
    single = equilibrium(ARM, LENGTHS.astype(jnp.float32))
    np.testing.assert_allclose(single.by_gain, FOUND.by_gain, rtol=1e-2, atol=1e-5)
