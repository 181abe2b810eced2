"""A toy environment with an expert, whose envs can be made to diverge."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.learning.ppo.environment import State

NUM_ENVS = 32


@struct.dataclass
class Inner:
    key: jax.Array
    value: jax.Array
    time: jax.Array
    is_broken: jax.Array


@struct.dataclass
class DriftingEnvironment:
    """A number drifts about and is pushed by the action; the expert pushes it back by half of what it is.

    The numbers are leaves, so that all variants share compiled programs.
    """

    broken_share: Any = np.float32(0)
    """Probability that an env is broken: it diverges again and again, and its expert always says 1."""
    period: Any = np.int32(1)
    """A broken env diverges at its steps period - 1, 2 period - 1, ..."""
    limit: Any = np.float32(np.inf)
    """An env diverges where its number would get further than this from 0; then it is 0."""
    earns_up_to: Any = np.float32(np.inf)
    """The reward is no number where the env's number is further than this from 0."""
    has_expert: bool = struct.field(pytree_node=False, default=True)
    action_size: int = struct.field(pytree_node=False, default=1)

    def reset(self, keys):
        key, of_value, of_fate = jnp.unstack(jax.vmap(lambda key: jax.random.split(key, 3))(keys), axis=1)
        is_broken = _uniform(of_fate, 0, 1) < self.broken_share
        inner = Inner(key, _uniform(of_value, -1, 1), jnp.zeros(len(keys), jnp.int32), is_broken)
        return self._state(inner, jnp.ones(len(keys), bool))

    def step(self, state, actions):
        before = state.inner
        key, of_noise = jnp.unstack(jax.vmap(jax.random.split)(before.key), axis=1)
        moved = before.value + _uniform(of_noise, -0.3, 0.3) + 0.5 * actions[:, 0]
        is_near = jnp.abs(moved) <= self.limit
        breaks = before.is_broken & (before.time % self.period == self.period - 1)
        value = jnp.where(is_near, jnp.clip(moved, -1, 1), 0)
        return self._state(Inner(key, value, before.time + 1, before.is_broken), is_near & ~breaks)

    def _state(self, inner, valid):
        value, ones, never = inner.value, jnp.ones_like(inner.value), jnp.zeros_like(valid)
        seen = {"state": jnp.stack([value, ones], axis=1), "privileged_state": jnp.stack([ones, value], axis=1)}
        if self.has_expert:
            seen["expert_action"] = jnp.where(inner.is_broken, 1, -0.5 * value)[:, None]
        reward = jnp.where(jnp.abs(value) <= self.earns_up_to, -jnp.abs(value), jnp.nan)
        return State(inner, seen, seen, reward, never, never, valid, {})


def _uniform(keys, low, high):
    return jax.vmap(lambda key: jax.random.uniform(key, (), jnp.float32, low, high))(keys)
