import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct
from hypothesis import given, settings
from hypothesis import strategies as st

from qjrl.learning.ppo.environment import State
from qjrl.learning.ppo.episodes import empty_log, summary
from qjrl.learning.ppo.rollout import Action, collect, finite_rows

STEPS, ENVS = 4, 2
EVENTS = ("truncated", "terminated", "invalid", "broken", "broken_reward", "broken_end")
"""What can happen in a step; `broken` is the observation after it, `broken_end` the final observation of its episode."""


def table(*places):
    """(STEPS, ENVS) bool: where it happens."""
    found = np.zeros((STEPS, ENVS), bool)
    for place in places:
        found[place] = True
    return found


@struct.dataclass
class Scripted:
    """Two envs; both observations hold [steps so far, env], final ones 100 more; the reward is the step, from 0."""

    events: dict[str, np.ndarray]
    action_size: int = struct.field(pytree_node=False, default=1)

    def reset(self, keys):
        time, never = jnp.zeros(len(keys), jnp.int32), jnp.zeros(len(keys), bool)
        seen, zeros = _seen(time, never), jnp.zeros(len(keys), jnp.float32)
        return State(time, seen, seen, zeros, never, never, ~never, {"m": zeros})

    def step(self, state, actions):
        assert actions.shape == (ENVS, 1)
        now = {name: jnp.asarray(rows)[state.inner[0]] for name, rows in self.events.items()}
        step, after = state.inner.astype(jnp.float32), state.inner + 1
        reward = jnp.where(now["broken_reward"], jnp.inf, step)
        final = {name: rows + 100 for name, rows in _seen(after, now["broken_end"]).items()}
        seen = _seen(after, now["broken"])
        return State(after, seen, final, reward, now["terminated"], now["truncated"], ~now["invalid"], {"m": step})


def _seen(time, is_broken):
    rows = jnp.stack([time, jnp.arange(ENVS)], axis=1).astype(jnp.float32)
    rows = jnp.where(is_broken[:, None], jnp.nan, rows)
    return {"state": rows, "privileged_state": rows}


def scripted(**events):
    return Scripted({name: table() for name in EVENTS} | {name: table(*places) for name, places in events.items()})


def act(observation, row):
    """The action is the number of steps seen, the raw action the step's input."""
    return Action(observation[:, :1], row, jnp.concatenate([row, row], axis=1), jnp.zeros(ENVS, jnp.float32))


def value(rows):
    return rows[:, 0] + 1000 * rows[:, 1]


@functools.partial(jax.jit, static_argnames="num_steps")
def go_on(env, state, episodes, num_steps=STEPS):
    inputs = 10 * jnp.arange(num_steps, dtype=jnp.float32)[:, None, None] * jnp.ones((1, ENVS, 1), jnp.float32)
    return collect(env, act, value, state, episodes, inputs)


@jax.jit
def begun(env):
    return env.reset(jax.random.split(jax.random.key(0), ENVS)), empty_log(ENVS, ["m"])


def collected(**events):
    env = scripted(**events)
    return go_on(env, *begun(env))


def places(rows):
    return [tuple(place) for place in np.argwhere(rows).tolist()]


def value_of(time, env_id):
    return value(np.array([[time, env_id]]))[0]


def test_a_rollout_holds_what_was_seen_decided_and_earned_in_the_order_of_the_steps():
    result = collected()
    rollout = result.rollout
    assert rollout.observation["state"].tolist() == [[[step, 0], [step, 1]] for step in range(STEPS)]
    assert rollout.action[:, :, 0].tolist() == [[step, step] for step in range(STEPS)]
    assert rollout.raw_action[:, :, 0].tolist() == [[10 * step, 10 * step] for step in range(STEPS)]
    assert result.last_observation.tolist() == [[STEPS, 0], [STEPS, 1]]
    assert result.state.inner.tolist() == [STEPS, STEPS]
    assert rollout.reward[:, 0].tolist() == [0, 1, 2, 3]
    assert rollout.valid.all()


def test_the_value_of_the_final_observation_stands_where_an_episode_was_cut_off_and_nowhere_else():
    rollout = collected(truncated=[(1, 0), (3, 0), (3, 1)]).rollout
    assert places(rollout.truncated) == [(1, 0), (3, 0), (3, 1)]
    expected = np.zeros((STEPS, ENVS))
    expected[1, 0], expected[3] = value_of(102, 100), [value_of(104, 100), value_of(104, 101)]
    assert rollout.final_value.tolist() == expected.tolist()


def test_termination_goes_before_a_time_limit():
    rollout = collected(truncated=[(1, 0)], terminated=[(1, 0)]).rollout
    assert not rollout.truncated.any()
    assert not rollout.final_value.any()
    assert places(rollout.terminated) == [(1, 0)]


def test_a_diverged_step_is_not_valid():
    rollout = collected(invalid=[(2, 1)]).rollout
    assert places(~rollout.valid) == [(2, 1)]
    assert rollout.reward[2].tolist() == [2, 0]


def test_steps_from_and_to_an_observation_that_is_not_finite_are_not_valid():
    rollout = collected(broken=[(1, 0)]).rollout
    assert places(~rollout.valid) == [(1, 0), (2, 0)]
    assert np.isfinite(rollout.observation["state"]).all()


def test_a_broken_observation_after_the_end_of_an_episode_leaves_the_end_valid():
    rollout = collected(broken=[(1, 0)], terminated=[(1, 0)]).rollout
    assert places(~rollout.valid) == [(2, 0)]


def test_an_episode_cut_off_at_an_observation_that_is_not_finite_ends_with_an_invalid_step_without_reward():
    rollout = collected(broken_end=[(2, 0)], truncated=[(2, 0)]).rollout
    assert places(~rollout.valid) == [(2, 0)]
    assert rollout.reward[2].tolist() == [0, 2]
    assert np.isfinite(rollout.final_value).all()


def test_a_rollout_that_begins_with_a_broken_observation_begins_with_an_invalid_step():
    first = collected(broken=[(3, 1)])
    assert places(~first.rollout.valid) == [(3, 1)]
    again = go_on(scripted(), first.state.replace(inner=jnp.zeros(ENVS, jnp.int32)), first.episodes)
    assert places(~again.rollout.valid) == [(0, 1)]


@pytest.mark.parametrize("broken", [np.nan, np.inf, -np.inf])
def test_rows_with_one_broken_number_are_found(broken):
    rows = np.ones((2, 3), np.float32)
    rows[1, 2] = broken
    clean, is_finite = finite_rows({"state": np.ones((2, 1), np.float32), "privileged_state": rows})
    assert is_finite.tolist() == [True, False]
    assert clean["state"].tolist() == [[1], [0]]
    assert clean["privileged_state"].tolist() == [[1, 1, 1], [0, 0, 0]]


def test_episodes_are_summed_over_rollouts_and_broken_ones_forgotten():
    env = scripted(truncated=[(2, 0), (2, 1)], invalid=[(0, 1)])
    first = go_on(env, *begun(env), num_steps=2)
    assert summary(first.episodes.totals())["return"] is None
    found = summary(go_on(env, first.state, first.episodes.cleared(), num_steps=2).episodes.totals())
    assert found["episodes"] == 2
    assert found["return"] == 3.0  # 0 + 1 + 2, and 1 + 2 of the env that lost its first step
    assert found["episode_length"] == 2.5
    assert found["env/m"] == 2.5
    assert found["env_end/m"] == 2.0


marks = st.lists(st.booleans(), min_size=STEPS * ENVS, max_size=STEPS * ENVS)


@settings(max_examples=100)
@given(st.fixed_dictionaries(dict.fromkeys(EVENTS, marks)))
def test_whatever_happens_a_rollout_is_what_a_plain_loop_over_steps_and_envs_says(drawn):
    events = {name: np.reshape(flat, (STEPS, ENVS)) for name, flat in drawn.items()}
    env = Scripted(events)
    result = jax.tree.map(np.asarray, go_on(env, *begun(env)))
    rollout, expected = result.rollout, [looped_over(env_id, events) for env_id in range(ENVS)]
    for env_id, (valid, final_values, _) in enumerate(expected):
        assert rollout.valid[:, env_id].tolist() == valid
        assert rollout.reward[:, env_id].tolist() == [step if valid[step] else 0 for step in range(STEPS)]
        assert rollout.final_value[:, env_id].tolist() == final_values
    np.testing.assert_array_equal(rollout.terminated, events["terminated"])
    np.testing.assert_array_equal(rollout.truncated, events["truncated"] & ~events["terminated"])
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((rollout, result.last_observation)))
    returns = [total for _, _, totals in expected for total in totals]
    found = summary(result.episodes.totals())
    assert found["episodes"] == len(returns)
    assert found["return"] == (pytest.approx(np.mean(returns)) if returns else None)


def looped_over(env_id, events):
    """Which steps of an env are valid, the values of its final observations, and the returns of its whole episodes."""
    valid, final_values, returns, total, saw_broken = [], [], [], 0.0, False
    for step in range(STEPS):
        now = {name: bool(rows[step, env_id]) for name, rows in events.items()}
        is_cut_off, has_ended = now["truncated"] and not now["terminated"], now["truncated"] or now["terminated"]
        is_sound = not (now["invalid"] or now["broken_reward"])
        is_blind = saw_broken or (now["broken"] and not has_ended) or (now["broken_end"] and is_cut_off)
        valid.append(is_sound and not is_blind)
        end = 0.0 if now["broken_end"] else float(value_of(step + 101, env_id + 100))  # of zeros, and not valid
        final_values.append(end if is_cut_off else 0.0)
        total = total + step if is_sound else 0.0
        if has_ended and is_sound:
            returns.append(total)
        total, saw_broken = 0.0 if has_ended else total, now["broken"]
    return valid, final_values, returns
