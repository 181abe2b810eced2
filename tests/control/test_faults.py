import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, over_rows
from worlds import ARM, CONFIG, World, assert_same_bits, random_actions

from qjrl.control.faults import Faults, draw_faults, play, transmit
from qjrl.control.randomisation import RandomisationConfig
from qjrl.robot import strand_commands


def drawn(count=2000, arm=ARM, **changes) -> Faults:
    config, home = RandomisationConfig(**changes), jnp.zeros(arm.num_cables)
    keys = jax.random.split(jax.random.key(0), count)
    return jax.jit(jax.vmap(lambda key: draw_faults(config, arm, key, home)))(keys)


def transmitted(commands: np.ndarray, **changes) -> np.ndarray:
    """What the cables hold, control period by control period."""
    faults, held = jax.tree.map(lambda value: value[0], drawn(1, **changes)), []
    step = jax.jit(transmit)
    for command in commands:
        faults = step(faults, jnp.asarray(command))
        held.append(faults.held)
    return np.array(held)


@pytest.fixture(scope="module")
def commands():
    return np.random.default_rng(0).normal(size=(40, ARM.num_cables)).cumsum(axis=0)


def test_without_faults_the_cables_hold_the_command(commands):
    np.testing.assert_array_equal(transmitted(commands), commands)


def test_a_delay_is_one_of_whole_control_periods(commands):
    held = transmitted(commands, delay=(2, 2))
    np.testing.assert_array_equal(held[2:], commands[:-2])
    np.testing.assert_array_equal(held[:2], np.zeros((2, ARM.num_cables)))


def test_play_follows_at_the_half_width_and_forgets_what_was_before_a_longer_way():
    """A driver to 5 and back: the cable stops half a width short of the turn and starts a whole width after it."""
    way = np.concatenate([np.arange(0.0, 6.0), np.arange(4.0, -1.0, -1.0)])
    held, found = jnp.zeros(()), []
    for place in way:
        held = play(held, jnp.asarray(place), jnp.asarray(1.5))
        found.append(float(held))
    assert found == [0.0, 0.0, 0.5, 1.5, 2.5, 3.5, 3.5, 3.5, 3.5, 2.5, 1.5]


def test_play_never_lets_the_cable_further_than_the_half_width_and_moves_it_no_more_than_that_needs(commands):
    width = 0.7
    held = transmitted(commands, backlash=(width, width))
    behind = commands - held
    assert np.abs(behind).max() <= width * (1 + 1e-12)
    moved = np.diff(held, axis=0) != 0.0
    np.testing.assert_allclose(np.abs(behind[1:][moved]), width, rtol=1e-12)  # moved only when it must
    assert 0.1 < moved.mean() < 0.9


def test_faults_are_drawn_within_their_ranges():
    found = drawn(backlash=(1e-4, 3e-4), delay=(1, 3), dead_encoder_share=0.25)
    assert found.backlash.min() >= 1e-4 and found.backlash.max() <= 3e-4
    np.testing.assert_allclose(np.bincount(found.delay)[1:] / 2000, 1 / 3, atol=0.04)
    missing = np.array(ARM.joints_per_segment) - np.asarray(found.working_encoders)
    assert set(missing.sum(axis=1)) == {0.0, 1.0}
    assert missing.sum() / 2000 == pytest.approx(0.25, abs=0.04)


def test_every_joint_is_as_likely_to_have_the_dead_encoder():
    arm = arm_named("rolling_312")
    missing = np.array(arm.joints_per_segment) - np.asarray(drawn(arm=arm, dead_encoder_share=1.0).working_encoders)
    np.testing.assert_allclose(missing.mean(axis=0), np.array(arm.joints_per_segment) / arm.num_joints, atol=0.04)


LATE = dataclasses.replace(
    CONFIG,
    randomisation=RandomisationConfig(
        payload=(0.05, 0.05), strand_stiffness_scale=(0.8, 1.2), delay=(1, 1), dead_encoder_share=0.5
    ),
)


@pytest.fixture(scope="module")
def late():
    return World(LATE)


def rest_lengths(world):
    return world.stepper._batch.ctrl.copy()


def test_an_episode_with_faults_is_the_same_once_more(late):
    actions, found = random_actions(CONFIG.episode_steps), []
    for _ in range(2):
        late.reset()
        outcomes = [late.step(action) for action in actions]
        assert late.seen.is_sound.all()
        found.append([dataclasses.replace(one, state=None) for one in outcomes])
    assert_same_bits(*found)


def test_the_controller_sees_its_command_and_the_strands_get_what_comes_through(late):
    late.reset()
    at_home = rest_lengths(late)
    first, second = random_actions(2)
    late.step(first)
    np.testing.assert_array_equal(rest_lengths(late), at_home)
    sent = over_rows(strand_commands, ARM, late.commands)
    assert np.any(sent != at_home, axis=1).all()
    late.step(second)
    np.testing.assert_array_equal(rest_lengths(late), sent)
