"""Equilibria and their slopes against arms that come to rest in time."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, over_rows, random_bends

from qjrl.robot import (
    cable_lengths,
    configuration_from_joint_positions,
    equilibrium,
    joint_positions,
    strand_commands,
    strand_tension,
)
from qjrl.robot.plant import PhysicalParameters
from qjrl.simulation import settle
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.engines import make_stepper
from qjrl.simulation.settle_problem import SettleConfig

ARM = arm_named("qj_22")
BENDS = jnp.array([[0.25, 0.1], [-0.2, 0.3]])
LENGTHS = cable_lengths(ARM, BENDS)
GAIN, TILT, PULL = 0.02, 0.01, 0.5
FOUND = equilibrium(ARM, LENGTHS)


def rested(physics, commands, **changed) -> np.ndarray:
    """Bends after 4 s of holding rest lengths (n, strands) [m], without friction."""
    count = len(commands)
    parameters = dataclasses.replace(PhysicalParameters.nominal(ARM, count), strand_friction=np.zeros(count), **changed)
    stepper = make_stepper(ARM, count, physics)
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
    found = rested(EngineConfig("minimal", 0.005), commands, gain_scale=gain, tilt=tilt)
    return (found[::2] - found[1::2]) / 2.0


def test_it_is_where_mujoco_rests():
    assert np.abs(rested(SettleConfig(num_threads=1), held(1))[0] - FOUND.configuration).max() < 2e-5
    assert np.abs(BENDS - FOUND.configuration).max() > 1e-3  # which is not where a perfect arm would be


def test_slopes_are_those_of_arms_that_differ(shifted):
    expected = [GAIN * FOUND.by_gain, *(TILT * np.moveaxis(FOUND.by_tilt, 2, 0)), PULL * FOUND.by_pull[..., 3]]
    for predicted, measured in zip(expected, shifted, strict=True):
        np.testing.assert_allclose(measured, predicted, rtol=0.02, atol=2e-6)


def test_the_slope_by_gain_is_smooth_in_single_precision():
    single = equilibrium(ARM, LENGTHS.astype(jnp.float32))
    np.testing.assert_allclose(single.by_gain, FOUND.by_gain, rtol=1e-2, atol=1e-5)


@pytest.mark.parametrize(("name", "steps"), [("qj_2222", 12), ("rolling_312", 60)])
def test_strands_carry_what_they_settle_at(name, steps):
    """Measured: 0.0065 N for the paper's arm, 0.016 N of 155 N for the other, which has far more curved strands: with 12
    steps it is 0.51 N off."""
    arm = arm_named(name)
    lengths = over_rows(cable_lengths, arm, random_bends(arm, 24, seed=1))
    rest, predicted = settle(arm, lengths), over_rows(lambda arm, row: strand_tension(arm, row, steps), arm, lengths)
    assert rest.converged.all() and 0 < rest.is_slack.any(axis=1).sum() < len(lengths)
    np.testing.assert_allclose(predicted, rest.strand_tension, atol=0.02)
    np.testing.assert_array_equal(predicted == 0.0, rest.strand_tension == 0.0)


def test_half_the_steps_find_the_least_loaded_strand():
    arm = arm_named("qj_2222")
    bends = random_bends(arm, 64, seed=2)
    at_limit = bends[:8] * np.sin(float(arm.bend_limit) / 2.0) / np.linalg.norm(bends[:8], axis=-1, keepdims=True)
    lengths = over_rows(cable_lengths, arm, np.concatenate([at_limit, bends]))
    few, many = (
        over_rows(lambda arm, row, n=n: strand_tension(arm, row, n), arm, lengths).min(axis=1) for n in (6, 60)
    )
    assert (many[:8] == 0.0).any() and (many > 2.0).any()
    np.testing.assert_allclose(few, many, atol=1e-6)
