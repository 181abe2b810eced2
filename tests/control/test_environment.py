"""The environment as one program: pure, float32, and arms that know nothing of each other."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from worlds import (
    ARM,
    CONFIG,
    ENGINE,
    NUM_ENVS,
    assert_same_bits,
    bank,
    keys_of,
    nothing,
    plain,
    policy_that,
    random_actions,
    reset,
    rows_in,
    shared_env,
    step,
)

from qjrl.config import ConfigError
from qjrl.control import motors
from qjrl.control.deployable import controller_functions
from qjrl.control.environment import residual_env
from qjrl.control.policy_training import acting
from qjrl.learning.ppo.environment import ACTOR_KEY, CRITIC_KEY, EXPERT_KEY, observation_sizes
from qjrl.robot import in_precision
from qjrl.simulation.engines import make_engine

DTYPES = {np.dtype(one) for one in (np.float32, np.int32, np.uint32, bool)}


@pytest.fixture(scope="module")
def env():
    return shared_env()


@pytest.fixture(scope="module")
def begun(env):
    return reset(env, keys_of())


def again(state):
    """The same state once more, its keys unused."""
    return jax.tree.map(
        lambda leaf: jax.random.wrap_key_data(jnp.asarray(plain(leaf))) if _is_key(leaf) else leaf, state
    )


def _is_key(leaf) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def run(env, state, actions):
    """All states after as many steps as there are actions."""
    state, states = again(state), []
    for action in actions:
        state = step(env, state, action)
        states.append(state)
    return states


def test_observations_have_a_row_an_arm_and_the_sizes_they_are_said_to_have(env, begun):
    with jax.enable_x64(False):
        sizes = observation_sizes(env)
    after = step(env, again(begun), random_actions(1)[0])
    for state in (begun, after):
        for seen in (state.observation, state.final_observation):
            assert {name: rows.shape for name, rows in seen.items()} == {n: (NUM_ENVS, k) for n, k in sizes.items()}
    assert sizes[CRITIC_KEY] > sizes[ACTOR_KEY] and sizes[EXPERT_KEY] == env.action_size == ARM.num_cables


def test_reset_and_step_give_one_structure_and_nothing_is_float64(env, begun):
    after = step(env, again(begun), random_actions(1)[0])
    assert jax.tree.structure(begun) == jax.tree.structure(after)
    for one, other in zip(jax.tree.leaves(begun), jax.tree.leaves(after), strict=True):
        assert (one.shape, one.dtype) == (other.shape, other.dtype)
        assert plain(one).dtype in DTYPES
    numbers = jax.tree.leaves((env.robot, env.tasks, env.engine))
    assert {np.asarray(leaf).dtype for leaf in numbers} <= DTYPES


def test_the_same_input_is_answered_by_the_same_bits(env, begun):
    actions = random_actions(CONFIG.episode_steps + 3)
    one, other = (run(env, begun, actions)[-1] for _ in range(2))
    assert_same_bits(one, other)
    assert_same_bits(reset(env, keys_of()), begun)
    assert not np.array_equal(reset(env, keys_of(1)).observation[ACTOR_KEY], begun.observation[ACTOR_KEY])


def test_arms_depend_on_their_key_alone(env, begun):
    """Exchanged, they do what they did; and begun by twos, by fours they are the same."""
    order, actions = np.array([2, 0, 3, 1]), random_actions(6)
    exchanged = run(env, reset(env, keys_of()[order]), actions[:, order])[-1]
    assert_same_bits(rows_in(exchanged, np.argsort(order)), rows_in(run(env, begun, actions)[-1], np.arange(NUM_ENVS)))
    halves = [reset(env, keys_of()[half]) for half in (slice(0, 2), slice(2, 4))]
    for whole, *parts in zip(*map(jax.tree.leaves, (begun, *halves)), strict=True):
        np.testing.assert_allclose(np.concatenate([plain(part) for part in parts]), plain(whole), atol=1e-6)


def test_later_episodes_are_whole_and_end_by_the_time_limit_alone(env, begun):
    for number, state in enumerate(run(env, begun, random_actions(2 * CONFIG.episode_steps)), 1):
        assert not np.any(state.terminated) and np.all(state.valid)
        assert np.all(np.asarray(state.truncated) == (number % CONFIG.episode_steps == 0))


def test_first_episodes_are_spread_over_all_phases_and_later_ones_are_whole(env):
    states = run(env, reset(env, keys_of(3), spread=True), [nothing()] * 3 * CONFIG.episode_steps)
    ends = np.array([state.truncated for state in states])
    for column in ends.T:
        at = np.flatnonzero(column) + 1
        assert 1 <= at[0] <= CONFIG.episode_steps
        assert set(np.diff(at)) == {CONFIG.episode_steps}
    assert len({int(np.argmax(column)) for column in ends.T}) > 1


def test_only_arms_whose_episode_ended_begin_anew(env):
    """The others' bits are those of a run in which nobody ends."""
    spread = reset(env, keys_of(4), spread=True)
    whole = dataclasses.replace(spread.inner.episode, episode_steps=jnp.full(NUM_ENVS, 1000, jnp.int32))
    endless = dataclasses.replace(spread, inner=dataclasses.replace(spread.inner, episode=whole))
    actions = random_actions(CONFIG.episode_steps)
    is_first, some_ended = np.ones(NUM_ENVS, bool), 0
    for one, other in zip(run(env, spread, actions), run(env, endless, actions), strict=True):
        ended, commands = np.asarray(one.truncated), np.asarray(one.inner.episode.control.command)
        for name, final in one.final_observation.items():
            np.testing.assert_array_equal(final[~ended], one.observation[name][~ended])
            np.testing.assert_array_equal(final[is_first], other.observation[name][is_first])
            if name != EXPERT_KEY:
                assert np.any(final[ended] != one.observation[name][ended], axis=1).all()
        is_first &= ~ended
        same = [tree.inner.plant for tree in (one, other)], [tree.inner.episode.control for tree in (one, other)]
        for left, right in same:
            assert_same_bits(rows_in(left, is_first), rows_in(right, is_first))
        assert np.all(commands[ended] == 0.0) and np.all(np.any(commands[~ended] != 0.0, axis=1))
        some_ended += ended.any() and not ended.all()
    assert some_ended >= 2 and not is_first.any()


def test_who_begins_anew_is_another_arm(env, begun):
    last = run(env, begun, [nothing()] * CONFIG.episode_steps)[-1]
    for name in ("strand_friction", "strand_stiffness"):
        one, other = (getattr(state.inner.plant.physics, name) for state in (begun, last))
        assert np.all(np.any(np.reshape(one != other, (NUM_ENVS, -1)), axis=1))
    assert np.all(np.any(last.observation[ACTOR_KEY] != last.final_observation[ACTOR_KEY], axis=1))


def altered(state, **moving):
    """Another state of the physics."""
    guarded = state.inner.plant.state
    plant = state.inner.plant.replace(state=guarded.replace(moving=guarded.moving.replace(**moving)))
    return state.replace(inner=state.inner.replace(plant=plant))


def test_a_lost_arm_terminates_at_its_cost_and_begins_anew(env, begun):
    """Strands of arm 1 pull a hundred times as hard, for a second by its clock: the arm is lost, the simulation sound."""
    actions = random_actions(4)
    states, others = run(env, begun, actions), [0, 2, 3]
    arms = again(states[1]).inner
    physics, overloaded = arms.plant.physics, arms.episode.overloaded.at[1].set(1.0)
    physics = physics.replace(strand_stiffness=physics.strand_stiffness.at[1].multiply(100.0))
    arms = arms.replace(plant=arms.plant.replace(physics=physics), episode=arms.episode.replace(overloaded=overloaded))
    found = step(env, states[1].replace(inner=arms), actions[2])
    assert np.asarray(found.terminated).tolist() == [False, True, False, False]
    assert np.asarray(found.valid).all() and not np.any(found.truncated)
    assert np.all((np.asarray(found.reward) < -38.0) == np.asarray(found.terminated))
    assert np.all(np.asarray(found.inner.episode.control.command)[1] == 0.0) and found.metrics["position_error"][1] > 0
    assert_same_bits(rows_in(found, others), rows_in(states[2], others))
    assert not np.any(step(env, found, actions[3]).terminated)


def diverging(env, begun, how):
    """A run of which arm 2 diverges in step 4, the same without, and the states before it."""
    actions = random_actions(8)
    states = run(env, begun, actions)
    before, broken = again(states[2]), actions[3:].copy()
    if how == "an action that is no number":
        broken[0, 2] = np.nan
    else:
        before = altered(before, rates=before.inner.plant.state.moving.rates.at[2].set(np.float32(how)))
    return run(env, before, broken), states[3:], states[2]


@pytest.mark.parametrize("how", ["an action that is no number", 1e6, 1e12])
def test_a_diverged_simulation_is_invalid_begins_anew_and_spoils_no_other(env, begun, how):
    found, sound, before = diverging(env, begun, how)
    first, others = found[0], [0, 1, 3]
    assert np.asarray(first.valid).tolist() == [True, True, False, True]
    assert not np.any(first.truncated) and not np.any(first.terminated)
    assert first.reward[2] == 0.0 and np.isnan(first.metrics["position_error"][2])
    assert np.all(np.asarray(first.inner.episode.control.command)[2] == 0.0)
    assert first.inner.plant.physics.strand_friction[2] != before.inner.plant.physics.strand_friction[2]
    for one, other in zip(found, sound, strict=True):
        assert np.asarray(other.valid).all()
        assert_same_bits(rows_in(one, others), rows_in(other, others))
        assert all(np.isfinite(rows).all() for rows in one.observation.values())
    assert all(np.asarray(state.valid).all() for state in found[1:])


def test_the_untrained_policy_gives_exactly_the_base_controllers_commands(env, begun):
    """Bit for bit, over a whole episode: motor commands and the state of the physics."""
    act = acting(policy_that(0.0))
    state, base_alone = again(begun), run(env, begun, [nothing()] * (CONFIG.episode_steps - 1))
    for expected in base_alone:
        state = step(env, state, act(np.asarray(state.observation[ACTOR_KEY])))
        assert_same_bits(state, expected)


def test_the_base_controllers_commands_are_the_ramp(env, begun):
    states = run(env, begun, [nothing()] * (CONFIG.episode_steps - 1))
    lengths = np.asarray(begun.inner.episode.control.base_lengths)
    for number, state in enumerate(states, 1):
        for arm, base in enumerate(lengths):
            ramped = motors.ramped_base(ARM, jnp.asarray(base, float), jnp.asarray(number * CONFIG.control_period))
            np.testing.assert_allclose(state.inner.episode.control.command[arm], ramped, atol=1e-7)
    np.testing.assert_array_equal(states[-1].inner.episode.control.command, lengths)


@pytest.mark.parametrize("bias", [0.0, 0.7])
def test_a_deployed_controller_commands_what_the_environment_does_on_the_same_readings(env, begun, bias):
    """Step by step, over a whole episode: what is trained is what is shipped."""
    policy, control = policy_that(bias), begun.inner.episode.control
    act, state, expected, readings = acting(policy), again(begun), [], [control.reading]
    for _ in range(CONFIG.episode_steps - 1):
        state = step(env, state, act(np.asarray(state.observation[ACTOR_KEY])))
        expected.append(np.asarray(state.inner.episode.control.command))
        readings.append(state.inner.episode.control.reading)
    with jax.enable_x64(False):
        functions = controller_functions(CONFIG.controller, in_precision(ARM, "float32"), policy)
        begin, tick = (jax.jit(jax.vmap(function)) for function in (functions.begin, functions.step))
        deployed = begin(control.target, control.base_lengths, readings[0])
        for reading, commands in zip(readings[:-1], expected, strict=True):
            deployed = tick(deployed, reading)
            np.testing.assert_allclose(deployed["command"], commands, rtol=0.0, atol=1e-7)
    assert np.abs(expected[-1] - control.base_lengths).max() > (1e-3 if bias else -1.0)


def test_no_key_is_used_twice(env, begun):
    with jax.debug_key_reuse(True):
        run(env, begun, random_actions(CONFIG.episode_steps + 1))
        reset(env, keys_of(), spread=True)


def test_a_control_period_that_is_no_multiple_of_the_time_step_is_one_line():
    config = dataclasses.replace(CONFIG, control_period=0.022)
    with pytest.raises(ConfigError, match="control_period"):
        residual_env(ARM, config, bank(), make_engine(ARM, ENGINE))
