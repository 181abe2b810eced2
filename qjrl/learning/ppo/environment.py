"""What PPO asks of an environment: many copies stepped together, plain arrays in and out."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import jax
import numpy as np

Observation = Mapping[str, Any]
"""`state` (num_envs, n) for the actor and `privileged_state` (num_envs, m) for the critic, float32, numpy or jax.

An environment that knows what would have been best, since it knows more than the actor may, ends `privileged_state` with
that action (see `advice_of`)."""

ACTOR_KEY = "state"
CRITIC_KEY = "privileged_state"


def advice_of(observation: Observation, action_size: int) -> Any:
    """(..., action_size) the advised action in [-1, 1], with which `privileged_state` ends if the environment gives advice."""
    return observation[CRITIC_KEY][..., -action_size:]


@dataclasses.dataclass(frozen=True)
class Transition:
    """One step of all copies. A copy that has terminated or was truncated is reset at once; terminated goes first."""

    observation: Observation
    """After the automatic reset of the copies whose episode ended: what the next action answers to."""
    reward: Any
    """(num_envs,)."""
    terminated: Any
    """(num_envs,) bool: the episode ended for good, nothing comes after."""
    truncated: Any
    """(num_envs,) bool: the time limit; the value of `final_observation` stands for what would have come."""
    final_observation: Observation
    """Before the automatic reset; equal to `observation` where no episode ended."""
    valid: Any
    """(num_envs,) bool: False where the simulation diverged; such a step enters no update."""
    metrics: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Name -> (num_envs,), for the log only; the same names at every step."""
    diverged: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    """What is known of the copies that are not valid, one row each; for those who look for the cause."""


@runtime_checkable
class VectorEnv(Protocol):
    """`num_envs` copies of an environment that reset themselves.

    Arrays handed out must not be written to afterwards: a rollout keeps them until it copies them.
    """

    num_envs: int
    action_size: int
    observation_sizes: dict[str, int]
    """{"state": n, "privileged_state": m}."""
    gives_advice: bool
    """Whether `privileged_state` ends with an advised action."""

    def reset(self) -> Observation:
        """Starts every copy afresh."""
        ...

    def step(self, actions: np.ndarray) -> Transition:
        """Steps every copy; actions: (num_envs, action_size) float32 in [-1, 1]."""
        ...

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything a bitwise resume needs, random state included: a flat dict of numeric numpy arrays, each with a row for
        each copy where several processes train (`processes.gathered`)."""
        ...

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Goes back to what `get_state` returned."""
        ...


def num_copies(environment: VectorEnv) -> int:
    """Copies of the environment in all processes."""
    return environment.num_envs * jax.process_count()
