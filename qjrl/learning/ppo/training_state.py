"""Everything a PPO training needs to go on bit for bit, and its way to disk and back."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
from flax import serialization, struct

from qjrl.keys import key_for
from qjrl.learning import checkpoints as ckpt
from qjrl.learning import processes
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.environment import ACTOR_KEY, Observation, VectorEnv
from qjrl.learning.ppo.episodes import EpisodeLog
from qjrl.learning.ppo.normaliser import Normaliser, initial_normaliser
from qjrl.learning.ppo.policy import Policy
from qjrl.learning.ppo.update import Learner, make_learner


@struct.dataclass
class TrainingState:
    """The learner's side. No leaf is float64."""

    learner: Learner
    normaliser: Normaliser
    key: Any
    """Of the next iteration."""
    iteration: Any
    """Iterations done, int32."""
    env_steps: Any
    """Environment steps taken over all copies, uint32."""


@dataclasses.dataclass(frozen=True)
class Session:
    """The learner's side and the environment's."""

    state: TrainingState
    observation: Observation
    """What the next action answers to."""
    environment: VectorEnv
    episodes: EpisodeLog


def initial_state(
    initialise: Callable[[jax.Array], Any], config: PPOConfig, environment: VectorEnv, seed: int
) -> TrainingState:
    """The untrained state; `initialise` makes parameters of a key."""
    state = TrainingState(
        learner=make_learner(config, initialise(key_for(seed, "networks"))),
        normaliser=initial_normaliser(environment.observation_sizes),
        key=key_for(seed, "actions and minibatches"),
        iteration=jnp.int32(0),
        env_steps=jnp.uint32(0),
    )
    return jax.device_put(state, jax.local_devices()[0])  # committed, as a restored one is: one compilation for both


def policy_of(state: TrainingState, config: PPOConfig) -> Policy:
    """The actor by itself, on the host: copies, since the next update consumes the learner's arrays."""
    layers = state.learner.parameters["policy"]["params"]
    layers, mean, std = jax.tree.map(np.array, (layers, state.normaliser.mean, state.normaliser.std))
    return Policy(
        layers, mean[ACTOR_KEY], std[ACTOR_KEY], activation=config.activation, observation_clip=config.observation_clip
    )


@struct.dataclass
class Snapshot:
    """A session as plain arrays on the host: the learner's, and the environment's of all processes."""

    learner: dict[str, Any]
    """`TrainingState` as nested dicts of arrays, its key as the numbers that it is made of."""
    environment: dict[str, np.ndarray]
    """PART/NAME -> array, of the environment, the observation and the episodes under way."""


def snapshot(session: Session) -> Snapshot:
    """What a checkpoint holds; all processes take it together."""
    parts = {
        "environment": session.environment.get_state(),
        "observation": session.observation,
        "episodes": session.episodes.get_state(),
    }
    flat = {f"{part}/{name}": np.asarray(array) for part, arrays in parts.items() for name, array in arrays.items()}
    learner = serialization.to_state_dict(_with_plain_key(session.state))
    return Snapshot(jax.tree.map(np.asarray, learner), processes.gathered(flat))


def restored(session: Session, found: Snapshot) -> Session:
    """The session of a snapshot; this process's part of the environment's side is set back in place."""
    parts: dict[str, dict[str, Any]] = {"environment": {}, "observation": {}, "episodes": {}}
    for name, array in found.environment.items():
        part, _, rest = name.partition("/")
        parts[part][rest] = processes.own(array)
    session.environment.set_state(parts["environment"])
    session.episodes.set_state(parts["episodes"])
    state = serialization.from_state_dict(_with_plain_key(session.state), found.learner)
    state = jax.tree.map(jnp.asarray, state)
    state = jax.device_put(state.replace(key=jax.random.wrap_key_data(state.key)), jax.local_devices()[0])
    return dataclasses.replace(session, state=state, observation=parts["observation"])


def write_snapshot(
    checkpoints: ocp.CheckpointManager, found: Snapshot, metrics: dict[str, float | None] | None
) -> None:
    """Writes a checkpoint of both sides."""
    ckpt.save(checkpoints, int(found.learner["iteration"]), found.learner, metrics, found.environment)


def read_snapshot(checkpoints: ocp.CheckpointManager, step: int, like: Snapshot) -> Snapshot:
    """Both sides of a checkpoint; `like` gives the learner's shapes."""
    return Snapshot(ckpt.restore(checkpoints, step, like.learner), ckpt.restore_environment(checkpoints, step))


def _with_plain_key(state: TrainingState) -> TrainingState:
    return dataclasses.replace(state, key=jax.random.key_data(state.key))
