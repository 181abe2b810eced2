"""What an episode does, on the host over C MuJoCo, in float64."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from arms import over_rows
from worlds import ARM, CONFIG, NUM_ENVS, World, bank, nothing, random_actions

from qjrl.config import ConfigError, build
from qjrl.control import motors
from qjrl.control.bases import Base, environment_of
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.motors import DitherConfig
from qjrl.control.observations import ACTION_HISTORY
from qjrl.control.sensors import MEMORY_SIZE
from qjrl.control.tip_correction import IntegralConfig
from qjrl.learning.ppo.environment import ACTOR_KEY, EXPERT_KEY
from qjrl.robot import strand_commands

PERIOD = CONFIG.control_period
BASE = np.asarray(bank().base_lengths)[:NUM_ENVS]


@pytest.fixture(scope="module")
def world():
    return World()


def commands_of_an_episode(world, act):
    """Motor commands (steps, arms, cables) [m] up to the step before the last."""
    observation, commands = world.reset(), []
    for _ in range(world.config.episode_steps - 1):
        observation = world.step(act(observation)).observation
        commands.append(world.commands)
    return np.array(commands)


def test_the_base_controllers_commands_are_the_ramp(world):
    commands = commands_of_an_episode(world, lambda _: nothing())
    for arm, base in enumerate(BASE):
        expected = [motors.ramped_base(ARM, base, jnp.asarray(step * PERIOD)) for step in range(1, len(commands) + 1)]
        np.testing.assert_allclose(commands[:, arm], expected, atol=1e-15)
        np.testing.assert_array_equal(commands[-1, arm], base)  # arrived


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_residual_at_full_rate_during_the_ramp_never_makes_a_motor_too_fast(world, direction):
    action = direction * np.where(BASE < 0, -1.0, 1.0)
    commands = commands_of_an_episode(world, lambda _: action)
    steps = np.diff(np.concatenate([np.zeros((1, *BASE.shape)), commands]), axis=0)
    assert np.abs(steps).max() <= ARM.motor_speed * PERIOD * (1 + 1e-12)
    residual = np.minimum(CONFIG.residual.rate * PERIOD * len(commands), CONFIG.residual.bound) * action
    np.testing.assert_allclose(commands[-1], BASE + residual, atol=1e-9)  # summed, then limited


def test_the_physics_holds_the_strands_of_the_command(world):
    world.reset()
    world.step(random_actions(1)[0])
    held = over_rows(strand_commands, ARM, world.commands)
    np.testing.assert_array_equal(world.stepper._batch.ctrl, held)


def test_only_the_bases_that_have_them_dither_and_feed_back():
    """The motors' commands, once arrived: exact, dithering about the answer, or drifting by what the encoders say."""
    config = dataclasses.replace(
        CONFIG, integral=IntegralConfig(gain=20.0), dither=DitherConfig(amplitude=0.0005, decay=0.05)
    )
    bases: tuple[Base, ...] = ("nominal", "learned", "dither", "integral")
    moves = {
        base: commands_of_an_episode(World(environment_of(config, base)), lambda _: nothing()) - BASE for base in bases
    }
    shortest = int(np.ceil(max(float(motors.ramp_time(ARM, row)) for row in BASE) / PERIOD))
    arrived = {base: np.abs(move[shortest:]).max() for base, move in moves.items()}
    assert arrived["nominal"] == arrived["learned"] == 0.0
    assert 1e-4 < arrived["dither"] <= 5e-4 and arrived["integral"] > 1e-5


def test_dither_frees_an_arm_that_hardly_moves():
    """Friction holds a leaning arm upright at home; shaken, it rests where it would without friction."""
    near, drawn = bank(NUM_ENVS, share=1e-4), dataclasses.replace(CONFIG.randomisation, least_tilt_deg=5.0)
    tips = {}
    for friction, amplitude in ((0.0, 0.0), (3.0, 0.0), (3.0, 5e-4)):
        config = dataclasses.replace(
            CONFIG,
            dither=DitherConfig(amplitude=amplitude),
            randomisation=dataclasses.replace(drawn, strand_friction=(friction, friction)),
        )
        one = World(config, near)
        one.reset()
        for _ in range(99):
            one.step(nothing())
        tips[friction, amplitude] = np.array(one.seen.pose[:, :3])
    held, shaken = (np.linalg.norm(tips[3.0, swing] - tips[0.0, 0.0], axis=1) for swing in (0.0, 5e-4))
    assert np.linalg.norm(shaken) < 0.4 * np.linalg.norm(held)


def episode_with_the_expert(follows, amplitude):
    """The expert's action at every step without friction, beyond an episode's end, and the last position errors [m]."""
    drawn = dataclasses.replace(CONFIG.randomisation, strand_friction=(0.0, 0.0))
    config = dataclasses.replace(CONFIG, dither=DitherConfig(amplitude=amplitude), randomisation=drawn)
    one, actions, errors = World(config), [], []
    observation = one.reset()
    for _ in range(79):
        actions.append(np.asarray(observation[EXPERT_KEY]))
        outcome = one.step(follows * actions[-1])
        observation = outcome.observation
        errors.append(np.asarray(outcome.metrics["position_error"]))
    return np.array(actions), errors[-1]


def test_following_the_expert_takes_the_tip_to_its_target():
    _, ignored = episode_with_the_expert(0.0, 0.0)
    _, followed = episode_with_the_expert(1.0, 0.0)
    assert np.all(followed < 0.01 * ignored)


def test_the_expert_hardly_answers_the_swings():
    (shaken, _), (still, _) = episode_with_the_expert(0.0, 5e-4), episode_with_the_expert(0.0, 0.0)
    late = slice(45, None)  # swings of 0.2 mm and less
    assert np.abs(shaken[late] - still[late]).max() * CONFIG.residual.bound < 5e-5


def test_an_episode_is_over_at_its_last_step_alone(world):
    world.reset()
    for step in range(1, CONFIG.episode_steps + 1):
        outcome = world.step(random_actions(1, step)[0])
        assert not np.any(outcome.is_lost) and np.all(outcome.is_over == (step == CONFIG.episode_steps))


def test_the_actors_memory_of_its_actions_is_newest_first(world):
    world.reset()
    actions = random_actions(5)
    outcome = [world.step(action) for action in actions][-1]
    # base bends, deviations now and remembered, and what the tip lacks come first, also by the estimate
    start = 2 * ARM.num_segments * (1 + 1 + MEMORY_SIZE + 1) + 6 * (1 + MEMORY_SIZE + 1)
    seen = outcome.observation[ACTOR_KEY][:, start : start + ACTION_HISTORY * ARM.num_cables]
    expected = np.concatenate([actions[-1], actions[-2], actions[-3], actions[-4]], axis=1)
    np.testing.assert_array_equal(seen, expected)


def test_the_errors_reported_are_those_of_the_true_tip(world):
    world.reset()
    outcome = world.step(random_actions(1)[0])
    expected = np.linalg.norm(world.seen.pose[:, :3] - np.asarray(bank().target)[:NUM_ENVS, :3], axis=1)
    np.testing.assert_allclose(outcome.metrics["position_error"], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"latest_arrival": 3.6}, r"^environment.latest_arrival: got 3.6, allowed: at most 3.5"),
        ({"episode_steps": 0}, r"^environment.episode_steps: got 0"),
        ({"residual": {"rate": -1.0}}, r"^environment.residual.rate: got -1.0"),
    ],
)
def test_impossible_episodes_are_one_line(change, message):
    with pytest.raises(ConfigError, match=message):
        build(EnvironmentConfig, change, "environment")


def test_the_scored_time_is_whole_control_steps():
    assert EnvironmentConfig().scored_steps == 25
    assert dataclasses.replace(CONFIG, scored_time=0.05).scored_steps == 3
    assert CONFIG.scored_steps == 3
