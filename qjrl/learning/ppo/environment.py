"""What PPO asks of an environment: many envs stepped together, as pure functions of one pytree."""

from collections.abc import Mapping
from typing import Any, Protocol

import jax
from flax import struct

Observation = Mapping[str, Any]
"""`state` (envs, n) for the actor, `privileged_state` (envs, m) for the critic and, of an environment that knows what would
have been best, `expert_action` (envs, action size) in [-1, 1]; float32."""

ACTOR_KEY = "state"
CRITIC_KEY = "privileged_state"
EXPERT_KEY = "expert_action"


@struct.dataclass
class State:
    """All envs after a reset or a step. An env whose episode ended has begun anew; terminated goes before truncated."""

    inner: Any
    """The environment's own."""
    observation: Observation
    """What the next action answers to."""
    final_observation: Observation
    """Before the envs whose episode ended began anew; equal to `observation` for the others."""
    reward: Any
    """(envs,) float32."""
    terminated: Any
    """(envs,) bool: the episode ended for good, nothing comes after."""
    truncated: Any
    """(envs,) bool: the time limit; the value of `final_observation` stands for what would have come."""
    valid: Any
    """(envs,) bool: False where the simulation diverged; such a step enters no update, and the env begins anew."""
    metrics: Mapping[str, Any]
    """Name -> (envs,), for the log only; the same names at every step."""


class Env(Protocol):
    """An environment. It is a pytree, an argument of compiled programs, whose envs know nothing of each other."""

    @property
    def action_size(self) -> int:
        """Numbers of an action."""
        ...

    def reset(self, keys: jax.Array) -> State:
        """Begins as many envs as there are keys."""
        ...

    def step(self, state: State, actions: jax.Array) -> State:
        """Steps every env; actions: (envs, action_size) float32 in [-1, 1]."""
        ...


def observation_sizes(env: Env) -> dict[str, int]:
    """Name of an observation -> its size."""
    keys = jax.eval_shape(lambda: jax.random.split(jax.random.key(0), 1))
    observation = jax.eval_shape(env.reset, keys).observation
    return {name: rows.shape[1] for name, rows in observation.items()}
