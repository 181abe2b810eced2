import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from worlds import ARM, CONFIG, NUM_ENVS, World, bank, nothing, rows_of

from qjrl.control.evaluation import Evaluator
from qjrl.control.termination import TerminationConfig, is_lost, overloaded_for
from qjrl.robot import bends_from_angles, joint_positions
from qjrl.robot.plant import PlantState
from qjrl.simulation.stepping import MujocoStepper

TERMINATION = TerminationConfig()
STOP_DEG = ARM.config.joint.bend_limit_deg + ARM.config.joint.stop_margin_deg


def seen(tension=15.0, bend_deg=0.0) -> PlantState:
    """All strands at one tension, the second segment bent."""
    bends = bends_from_angles(jnp.array([0.0, 0.7]), jnp.array([0.0, math.radians(bend_deg)]))
    strands = jnp.full(ARM.num_strands, tension)
    places = joint_positions(ARM, bends)
    return PlantState(places, places, strands, strands, strands, jnp.zeros(9), jnp.ones((), bool))


def weak_arm(force: float):
    """Its motors give way at so many newtons between the two strands of a loop."""
    return dataclasses.replace(ARM, motor_force=jnp.asarray(force))


@pytest.mark.parametrize(("beyond", "lost"), [(-1.0, False), (2.9, False), (3.1, True)])
def test_an_arm_is_lost_when_a_joint_is_forced_past_its_stop(beyond, lost):
    assert bool(is_lost(TERMINATION, ARM, seen(bend_deg=STOP_DEG + beyond), jnp.zeros(()))) is lost


def test_an_overload_counts_from_its_beginning_and_a_break_starts_it_again():
    motors = ARM.config.motors.force
    pulled = dataclasses.replace(seen(), strand_tension=seen().strand_tension.at[3].add(motors))
    time, found = jnp.zeros(()), []
    for plant in (pulled, pulled, seen(), pulled):
        time = overloaded_for(ARM, time, plant, 0.02)
        found.append(float(time))
    assert found == pytest.approx([0.02, 0.04, 0.0, 0.02])
    assert float(overloaded_for(ARM, jnp.ones(()), seen(tension=ARM.config.strands.strength), 0.02)) > 1.0
    assert float(overloaded_for(ARM, jnp.ones(()), seen(tension=0.99 * ARM.config.strands.strength), 0.02)) == 0.0


def test_an_arm_is_lost_when_the_overload_lasts():
    assert not is_lost(TERMINATION, ARM, seen(), jnp.asarray(0.2))
    assert is_lost(TERMINATION, ARM, seen(), jnp.asarray(0.22))


@pytest.fixture(scope="module")
def weak():
    """Arms whose motors give way at a difference of 2 N, which is lost after 0.1 s."""
    config = dataclasses.replace(CONFIG, termination=TerminationConfig(overload_time=0.1))
    return weak_arm(2.0), config, rows_of(bank(), range(NUM_ENVS))


def test_an_arm_whose_motors_give_way_is_lost_at_its_cost_once_that_has_lasted(weak):
    robot, config, targets = weak
    world = World(config, targets, robot=robot)
    world.reset()
    lost = np.full(NUM_ENVS, -1)
    for step in range(CONFIG.episode_steps - 1):
        found = world.step(nothing())
        is_lost = np.asarray(found.is_lost)
        assert world.seen.is_sound.all() and not np.any(found.is_over)
        assert np.all((np.asarray(found.reward) < -38.0) == is_lost)
        lost[is_lost & (lost < 0)] = step
    assert lost.max() >= 5 and lost[lost >= 0].min() >= 5  # not before it has lasted 0.1 s


def test_a_lost_arm_is_not_valid_when_it_is_evaluated(weak):
    robot, config, targets = weak
    assert not Evaluator(robot, config, targets, MujocoStepper(ARM, NUM_ENVS), 0).evaluate().is_valid.all()
