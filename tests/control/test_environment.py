import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from worlds import (
    ARM,
    CONFIG,
    NUM_ENVS,
    assert_same_bits,
    bank,
    environment,
    judged_environment,
    random_actions,
)

from qjrl.config import ConfigError, build
from qjrl.control import motors
from qjrl.control.bases import BASES, environment_of
from qjrl.control.environment import ResidualEnvironment
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.motors import DitherConfig
from qjrl.control.observations import ACTION_HISTORY
from qjrl.control.policy_training import acting
from qjrl.control.sensors import MEMORY_SIZE
from qjrl.control.tip_correction import IntegralConfig
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.environment import ACTOR_KEY, CRITIC_KEY, VectorEnv, advice_of
from qjrl.learning.ppo.iteration import compile_functions
from qjrl.learning.ppo.training_state import initial_state, policy_of
from qjrl.simulation.stepping import MujocoStepper

PERIOD = CONFIG.control_period


def untrained_policy(env):
    config = PPOConfig(actor_layers=(16, 16), critic_layers=(16,))
    compiled = compile_functions(config, env)
    return policy_of(initial_state(compiled.initialise, config, env, 0), config)


def commands_of_an_episode(env, act):
    """Motor commands (steps, envs, cables) up to the step before the last, and strand commands held by the physics."""
    observation, commands, held = env.reset(), [], []
    for _ in range(CONFIG.episode_steps - 1):
        transition = env.step(act(observation[ACTOR_KEY]))
        observation = transition.observation
        commands.append(env.commands.copy())
        held.append(env.get_state()["physics/state"].copy())
    return np.array(commands), np.array(held)


@pytest.fixture(scope="module")
def env():
    return environment()


@pytest.fixture(scope="module")
def judged():
    return judged_environment()


def test_it_is_an_environment_for_ppo(env):
    assert isinstance(env, VectorEnv)
    observation = env.reset()
    assert {name: value.shape[1] for name, value in observation.items()} == env.observation_sizes
    assert {value.dtype for value in observation.values()} == {np.dtype(np.float32)}
    assert env.observation_sizes[CRITIC_KEY] > env.observation_sizes[ACTOR_KEY]


def test_the_untrained_policy_gives_exactly_the_base_controllers_commands(judged):
    """Bit for bit, over a whole episode: motor commands and the state of the physics."""
    untrained = acting(untrained_policy(judged))
    with_policy, physics_with_policy = commands_of_an_episode(judged, untrained)
    base_alone, physics_alone = commands_of_an_episode(judged, lambda seen: np.zeros((len(seen), ARM.num_cables)))
    np.testing.assert_array_equal(with_policy, base_alone)
    np.testing.assert_array_equal(physics_with_policy, physics_alone)


def test_the_base_controllers_commands_are_the_ramp(judged):
    commands, _ = commands_of_an_episode(judged, lambda seen: np.zeros((len(seen), ARM.num_cables)))
    for arm, base in enumerate(np.asarray(bank().base_lengths)[:NUM_ENVS]):
        expected = [motors.ramped_base(ARM, base, jnp.asarray(step * PERIOD)) for step in range(1, len(commands) + 1)]
        np.testing.assert_allclose(commands[:, arm], expected, atol=1e-15)
        np.testing.assert_array_equal(commands[-1, arm], base)  # arrived


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_residual_at_full_rate_during_the_ramp_never_makes_a_motor_too_fast(judged, direction):
    base = np.asarray(bank().base_lengths)[:NUM_ENVS]
    action = direction * np.where(base < 0, -1.0, 1.0).astype(np.float32)
    commands, _ = commands_of_an_episode(judged, lambda seen: action)
    steps = np.diff(np.concatenate([np.zeros((1, *base.shape)), commands]), axis=0)
    assert np.abs(steps).max() <= ARM.motor_speed * PERIOD * (1 + 1e-12)
    residual = np.minimum(CONFIG.residual.rate * PERIOD * len(commands), CONFIG.residual.bound) * action
    np.testing.assert_allclose(commands[-1], base + residual, atol=1e-9)  # summed, then limited


def test_the_physics_holds_the_strands_of_the_command(judged):
    """Through the tension of the strands: rest lengths alone differ between two identical arms."""
    from qjrl.robot import strand_commands

    judged.reset()
    judged.step(random_actions(1)[0])
    held = jax.vmap(lambda row: strand_commands(ARM, row))(judged.commands)
    np.testing.assert_array_equal(judged._stepper._batch.ctrl, held)


def test_only_the_bases_that_have_them_dither_and_feed_back(judged):
    """The motors' commands, once arrived: exact, dithering about the answer, or drifting by what the encoders say."""
    config = dataclasses.replace(
        CONFIG, integral=IntegralConfig(gain=20.0), dither=DitherConfig(amplitude=0.0005, decay=0.05)
    )
    nothing = lambda seen: np.zeros((len(seen), ARM.num_cables))  # noqa: E731
    moves = {}
    for base in BASES:
        one = environment(rows=np.arange(NUM_ENVS), config=environment_of(config, base))
        commands, _ = commands_of_an_episode(one, nothing)
        moves[base] = commands - np.asarray(bank().base_lengths)[:NUM_ENVS]
    shortest = int(np.ceil(max(float(motors.ramp_time(ARM, row)) for row in bank().base_lengths[:NUM_ENVS]) / PERIOD))
    arrived = {base: np.abs(move[shortest:]).max() for base, move in moves.items()}
    assert arrived["nominal"] == arrived["learned"] == 0.0
    assert 1e-4 < arrived["dither"] <= 5e-4 and arrived["integral"] > 1e-5


def test_dither_frees_an_arm_that_hardly_moves():
    """Friction holds a leaning arm upright at home; shaken, it rests where it would without friction."""
    near, drawn = bank(share=1e-4), dataclasses.replace(CONFIG.randomisation, least_tilt_deg=5.0, encoder_noise_deg=0.0)
    tips = {}
    for friction, amplitude in ((0.0, 0.0), (3.0, 0.0), (3.0, 5e-4)):
        config = dataclasses.replace(
            CONFIG,
            episode_steps=100,
            dither=DitherConfig(amplitude=amplitude),
            randomisation=dataclasses.replace(drawn, strand_friction=(friction, friction)),
        )
        one = environment(rows=np.arange(NUM_ENVS), config=config, targets=near)
        one.reset()
        for _ in range(config.episode_steps - 1):
            one.step(np.zeros((NUM_ENVS, ARM.num_cables)))
        tips[friction, amplitude] = np.array(one._stepper.read().pose[:, :3])
    held, shaken = (np.linalg.norm(tips[3.0, swing] - tips[0.0, 0.0], axis=1) for swing in (0.0, 5e-4))
    assert np.linalg.norm(shaken) < 0.4 * np.linalg.norm(held)


def advised_episode(follows, amplitude):
    """Advice at every step of an episode without friction, and the position errors at its end [m]."""
    drawn = dataclasses.replace(CONFIG.randomisation, strand_friction=(0.0, 0.0))
    config = dataclasses.replace(CONFIG, episode_steps=80, dither=DitherConfig(amplitude), randomisation=drawn)
    one, advised, errors = environment(rows=np.arange(NUM_ENVS), config=config), [], []
    observation = one.reset()
    for _ in range(config.episode_steps - 1):
        advised.append(np.asarray(advice_of(observation, ARM.num_cables)))
        transition = one.step(follows * advised[-1])
        observation = transition.observation
        errors.append(transition.metrics["position_error"])
    return np.array(advised), errors[-1]


def test_following_the_advice_takes_the_tip_to_its_target():
    _, ignored = advised_episode(0.0, 0.0)
    _, followed = advised_episode(1.0, 0.0)
    assert np.all(followed < 0.01 * ignored)


def test_the_advice_hardly_answers_the_swings():
    (shaken, _), (still, _) = advised_episode(0.0, 5e-4), advised_episode(0.0, 0.0)
    late = slice(45, None)  # swings of 0.2 mm and less
    assert np.abs(shaken[late] - still[late]).max() * CONFIG.residual.bound < 5e-5


def test_episodes_end_by_the_time_limit_alone(judged):
    judged.reset()
    for step in range(1, 2 * CONFIG.episode_steps + 1):
        transition = judged.step(random_actions(1, step)[0])
        assert not np.any(transition.terminated) and np.all(transition.valid)
        assert np.all(transition.truncated == (step % CONFIG.episode_steps == 0))


def test_first_episodes_are_cut_short_and_all_later_ones_whole(env):
    env.reset()
    ends = np.array([env.step(np.zeros((NUM_ENVS, ARM.num_cables))).truncated for _ in range(3 * CONFIG.episode_steps)])
    for column in ends.T:
        at = np.flatnonzero(column) + 1
        assert 1 <= at[0] <= CONFIG.episode_steps
        assert set(np.diff(at)) == {CONFIG.episode_steps}
    assert len({int(np.argmax(column)) for column in ends.T}) > 1


def test_only_arms_whose_episode_ended_start_anew(env):
    observation = env.reset()
    for step in range(CONFIG.episode_steps + 5):
        transition = env.step(random_actions(1, step)[0])
        going_on = ~np.asarray(transition.truncated)
        for name, final in transition.final_observation.items():
            np.testing.assert_array_equal(final[going_on], transition.observation[name][going_on])
            if not going_on.all():
                assert np.any(final[~going_on] != transition.observation[name][~going_on], axis=1).all()
        commands = env.commands
        assert np.all(commands[~going_on] == 0.0) and np.all(np.any(commands[going_on] != 0.0, axis=1))
        observation = transition.observation
    assert all(np.isfinite(value).all() for value in observation.values())


def test_the_actors_memory_of_its_actions_is_newest_first(judged):
    judged.reset()
    actions = random_actions(5)
    transition = [judged.step(action) for action in actions][-1]
    sizes = (
        ARM.num_cables
    )  # base bends, deviations now and remembered, and what the tip lacks come first, also by the estimate
    start = 2 * ARM.num_segments * (1 + 1 + MEMORY_SIZE + 1) + 6 * (1 + MEMORY_SIZE + 1)
    seen = transition.observation[ACTOR_KEY][:, start : start + ACTION_HISTORY * sizes]
    expected = np.concatenate([actions[-1], actions[-2], actions[-3], actions[-4]], axis=1)
    np.testing.assert_array_equal(seen, expected)


def test_the_errors_reported_are_those_of_the_true_tip(judged):
    judged.reset()
    transition = judged.step(random_actions(1)[0])
    tip = judged._stepper.read().pose[:, :3]
    expected = np.linalg.norm(tip - np.asarray(bank().target)[:NUM_ENVS, :3], axis=1)
    np.testing.assert_allclose(transition.metrics["position_error"], expected, atol=1e-12)


def test_a_state_taken_and_set_repeats_what_came_after_bit_for_bit(env):
    env.reset()
    actions = random_actions(CONFIG.episode_steps + 20)
    for action in actions[:10]:
        env.step(action)
    state = env.get_state()
    assert all(isinstance(value, np.ndarray) and value.dtype != object for value in state.values())
    kept = {name: value.copy() for name, value in state.items()}
    first = [env.step(action) for action in actions[10:]]
    after = env.get_state()
    other = environment(seed=99)
    other.set_state(kept)
    again = [other.step(action) for action in actions[10:]]
    for one, two in zip(first, again, strict=True):
        assert_same_bits(one.observation, two.observation)
        assert_same_bits(one.metrics, two.metrics)
        np.testing.assert_array_equal(one.reward, two.reward)
        np.testing.assert_array_equal(one.truncated, two.truncated)
    assert_same_bits(after, other.get_state())
    assert_same_bits(state, kept)  # what was handed out did not change under the steps
    assert np.any([one.truncated for one in first])


def test_an_untouched_environment_of_the_same_seed_is_the_same_and_of_another_is_not(env):
    first, again, other = env.reset(), environment().reset(), environment(seed=1).reset()
    assert_same_bits(first, again)
    assert not np.array_equal(first[ACTOR_KEY], other[ACTOR_KEY])


def test_a_diverged_simulation_is_invalid_starts_anew_and_spoils_no_other(env):
    actions = random_actions(6)
    env.reset()
    for action in actions[:3]:
        sound = env.step(action)
    sound = env.step(actions[3])
    env.reset()
    for action in actions[:3]:
        env.step(action)
    broken = actions[3].copy()
    broken[2] = np.nan
    transition = env.step(broken)
    others = [0, 1, 3]
    assert transition.valid.tolist() == [True, True, False, True]
    assert sound.diverged == {} and transition.diverged["copy"].tolist() == [2]
    assert np.isnan(transition.diverged["strand_commands"]).any()
    friction = env.get_state()["physics/strand_friction"][2]
    assert transition.diverged["state/pose"].shape == (1, 9)
    assert transition.diverged["parameters/strand_friction"] != friction  # that of the arm before it began anew
    assert not np.any(transition.truncated[2]) and not np.any(transition.terminated)
    assert transition.reward[2] == 0.0 and np.isnan(transition.metrics["position_error"][2])
    for name, value in transition.observation.items():
        np.testing.assert_array_equal(value[others], sound.observation[name][others])
        assert np.isfinite(value[2]).all()
    assert np.all(env.commands[2] == 0.0)
    for action in actions[4:]:
        transition = env.step(action)
        assert transition.valid.all() and np.isfinite(transition.observation[CRITIC_KEY]).all()


def test_a_simulation_that_blows_up_inside_the_physics_is_invalid_too(env):
    env.reset()
    state = env.get_state()
    env._stepper._velocities[1] = 1e9
    transition = env.step(random_actions(1)[0])
    assert transition.valid.tolist() == [True, False, True, True]
    assert np.isfinite(transition.observation[CRITIC_KEY]).all()
    assert env.step(random_actions(1)[0]).valid.all()
    env.set_state(state)


def test_no_key_is_used_twice(env):
    with jax.debug_key_reuse(True):
        env.reset()
        for action in random_actions(CONFIG.episode_steps + 1):
            env.step(action)


def test_bare_physics_can_be_stepped_to_compare_rates_with(env):
    env.reset()
    env.step(random_actions(1)[0])
    command = env.commands.copy()
    env.step_physics()
    np.testing.assert_array_equal(env.commands, command)


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


def test_arms_in_two_halves_are_those_of_one_whole():
    def reset(num_envs, first):
        world = ResidualEnvironment(ARM, CONFIG, bank(), MujocoStepper(ARM, num_envs), 0, first=first)
        return world.get_state()

    whole, halves = reset(4, 0), [reset(2, 0), reset(2, 2)]
    for name, values in whole.items():
        np.testing.assert_allclose(np.concatenate([half[name] for half in halves]), values, atol=1e-12, err_msg=name)
