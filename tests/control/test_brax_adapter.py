"""The environment under brax's own wrappers and parts of its trainers. Slow: each wraps, and compiles, the step anew."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from worlds import ARM, CONFIG, NUM_ENVS, keys_of, reset, shared_env, step

from qjrl.control.brax_adapter import BraxResidualEnv
from qjrl.learning.ppo.environment import ACTOR_KEY, observation_sizes

base, training = pytest.importorskip("brax.envs.base"), pytest.importorskip("brax.envs.wrappers.training")
NUM_STEPS = 5


@pytest.fixture(scope="module")
def single():
    """Brax's programs are those of single precision."""
    with jax.enable_x64(False), jax.debug_key_reuse(False):  # brax splits keys that it goes on with
        yield


@pytest.fixture(scope="module")
def env(single):
    return BraxResidualEnv(shared_env())


def test_it_is_an_environment_of_brax_with_the_sizes_of_ours(env):
    assert isinstance(env, base.Env)
    assert env.observation_size == observation_sizes(shared_env()) and env.action_size == ARM.num_cables
    assert env.backend == "MinimalEngine" and env.episode_length == CONFIG.episode_steps


@pytest.mark.slow
def test_brax_s_wrappers_and_rollouts_earn_what_the_environment_does(env):
    """Acting, over a whole episode and beyond its end, which is a time limit and no loss."""
    from brax.training.acting import generate_unroll

    wrapped, keys = training.wrap(env, episode_length=env.episode_length, action_repeat=1), keys_of(7)
    first, length = jax.jit(wrapped.reset)(jax.random.key_data(keys)), CONFIG.episode_steps + NUM_STEPS
    act: Any = lambda seen, key: (0.5 * jnp.tanh(seen[ACTOR_KEY][:, : ARM.num_cables]) + 0.1, {})  # noqa: E731
    unroll = jax.jit(lambda state, key: generate_unroll(wrapped, state, act, key, length, ("truncation",)))
    last, seen = unroll(first, jax.random.key_data(jax.random.key(1)))
    state, rewards, ends = reset(shared_env(), keys), [], []
    for action in seen.action[: CONFIG.episode_steps]:
        state = step(shared_env(), state, action)
        rewards.append(state.reward)
        ends.append(state.truncated)
    earned, again = np.split(seen.reward, [CONFIG.episode_steps])
    np.testing.assert_allclose(earned, rewards, rtol=0.0, atol=1e-5)
    np.testing.assert_array_equal(again, earned[:NUM_STEPS])  # brax's wrapper begins the same episode once more
    for said in (seen.discount == 0.0, seen.extras["state_extras"]["truncation"]):
        np.testing.assert_array_equal(said, [*ends, *np.zeros((NUM_STEPS, NUM_ENVS))])
    assert last.done.shape == (NUM_ENVS,)


@pytest.mark.slow
def test_brax_s_ppo_does_not_run_on_the_pinned_jax(env):
    """Whoever mends brax learns it here, and changes the module's docstring."""
    from brax.training.agents.ppo.train import train

    sizes: dict[str, Any] = {
        "num_timesteps": 1,
        "num_envs": 2,
        "batch_size": 2,
        "num_minibatches": 1,
        "unroll_length": 1,
    }
    with pytest.raises(AttributeError, match="device_put_replicated"):
        train(environment=env, episode_length=env.episode_length, **sizes)
