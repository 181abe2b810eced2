"""Small worlds for the tests of controllers: the two-segment arm, a few targets, short episodes."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from arms import arm_named, over_rows, random_bends

from qjrl.control.arm_estimate import EstimateConfig
from qjrl.control.environment import ResidualEnvironment
from qjrl.control.episode import Bank, EnvironmentConfig
from qjrl.control.motors import DitherConfig, ResidualConfig
from qjrl.control.tip_correction import IntegralConfig
from qjrl.robot import cable_lengths, forward_kinematics
from qjrl.simulation.stepping import MujocoStepper

ARM = arm_named("qj_22")
NUM_ENVS = 4
CONFIG = EnvironmentConfig(
    episode_steps=24,
    latest_arrival=0.4,
    scored_time=0.06,
    estimate=EstimateConfig(acts=False),
    dither=DitherConfig(amplitude=0.0),
    integral=IntegralConfig(gain=0.0),
    residual=ResidualConfig(space="cables", bound=0.003, rate=0.01, lag=0.0),
)


def bank(count=8, seed=0, share=0.15):
    """Targets near enough for short episodes, with the closed form's commands."""
    bends = random_bends(ARM, count, seed, share)
    return Bank(
        jnp.asarray(over_rows(forward_kinematics, ARM, bends)), jnp.asarray(over_rows(cable_lengths, ARM, bends))
    )


def environment(seed=0, rows=None, num_envs=NUM_ENVS, config=CONFIG, targets=None):
    targets = bank() if targets is None else targets
    return ResidualEnvironment(ARM, config, targets, MujocoStepper(ARM, num_envs), seed, rows)


def judged_environment(seed=0, **changes):
    """Arm i reaches target i, in one whole episode."""
    return environment(seed, rows=np.arange(NUM_ENVS), config=dataclasses.replace(CONFIG, **changes))


def random_actions(count, seed=0, num_envs=NUM_ENVS):
    return np.random.default_rng(seed).uniform(-1, 1, (count, num_envs, ARM.num_cables)).astype(np.float32)


def assert_same_bits(one, other):
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
