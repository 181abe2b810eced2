"""Toy environments, each of which only works if one mechanism of PPO does.

The idea is Andy Jones's (andyljones.com/posts/rl-debugging.html): value loss; backpropagation to the observation;
discount; policy gradient; policy gradient by observation.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.learning.ppo.environment import State

NUM_ENVS = 64

Observe = Callable[[jax.Array, jax.Array], jax.Array]
"""(key, steps since the start of the episode) -> number."""
Reward = Callable[[jax.Array, jax.Array], jax.Array]
"""(observation (n,), action (n,)) -> (n,)."""


def a_sign(key, time):
    """-1 or 1."""
    del time
    return jnp.where(jax.random.bernoulli(key), 1.0, -1.0)


def nothing(key, time):
    """Always 0."""
    del key, time
    return jnp.float32(0)


def the_time(key, time):
    """Steps since the start of the episode."""
    del key
    return time.astype(jnp.float32)


@struct.dataclass
class Inner:
    key: jax.Array
    time: jax.Array
    seen: jax.Array


@struct.dataclass
class ProbeEnvironment:
    """Episodes of `length` steps; every observation is drawn afresh."""

    observe: Observe = struct.field(pytree_node=False)
    reward: Reward = struct.field(pytree_node=False)
    length: int = struct.field(pytree_node=False, default=1)
    truncates: bool = struct.field(pytree_node=False, default=False)
    action_size: int = struct.field(pytree_node=False, default=1)

    def reset(self, keys):
        inner, observation = self._seen(keys, jnp.zeros(len(keys), jnp.int32))
        zeros, never = jnp.zeros(len(keys), jnp.float32), jnp.zeros(len(keys), bool)
        return State(inner, observation, observation, zeros, never, never, ~never, {"size": zeros})

    def step(self, state, actions):
        before = state.inner
        reward = jnp.asarray(self.reward(before.seen, actions[:, 0]), jnp.float32)
        ends = before.time + 1 == self.length
        _, final = self._seen(jax.random.clone(before.key), before.time + 1)
        inner, observation = self._seen(before.key, jnp.where(ends, 0, before.time + 1))
        never = jnp.zeros_like(ends)
        terminated, truncated = (never, ends) if self.truncates else (ends, never)
        return State(inner, observation, final, reward, terminated, truncated, ~never, {"size": jnp.abs(reward)})

    def _seen(self, keys, time):
        both = jax.vmap(jax.random.split)(keys)
        seen = jax.vmap(self.observe)(both[:, 0], time).astype(jnp.float32)
        return Inner(both[:, 1], time, seen), {"state": seen[:, None], "privileged_state": seen[:, None]}
