"""Everything a PPO training needs to go on bit for bit, and its way to disk and back."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
from flax import struct

from qjrl.learning import checkpoints as ckpt
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
    key_parameters, key = jax.random.split(jax.random.key(seed))
    state = TrainingState(
        learner=make_learner(config, initialise(key_parameters)),
        normaliser=initial_normaliser(environment.observation_sizes),
        key=key,
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


def save_session(checkpoints: ocp.CheckpointManager, session: Session, metrics: dict[str, float | None] | None) -> None:
    """Writes a checkpoint of both sides."""
    parts = {
        "environment": session.environment.get_state(),
        "observation": session.observation,
        "episodes": session.episodes.get_state(),
    }
    flat = {f"{part}/{name}": np.asarray(array) for part, arrays in parts.items() for name, array in arrays.items()}
    ckpt.save(checkpoints, int(session.state.iteration), session.state, metrics, flat)


def restore_session(checkpoints: ocp.CheckpointManager, step: int, session: Session) -> Session:
    """Both sides of a checkpoint; `session` gives the shapes, and its environment is set back in place."""
    flat = ckpt.restore_environment(checkpoints, step)
    parts: dict[str, dict[str, Any]] = {"environment": {}, "observation": {}, "episodes": {}}
    for name, array in flat.items():
        part, _, rest = name.partition("/")
        parts[part][rest] = array
    session.environment.set_state(parts["environment"])
    session.episodes.set_state(parts["episodes"])
    state = ckpt.restore(checkpoints, step, session.state)
    return dataclasses.replace(session, state=state, observation=parts["observation"])
