"""Everything a PPO training needs to go on bit for bit, as one pytree, and its way to disk and back."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
from flax import serialization, struct
from jax.sharding import Mesh

from qjrl.learning import checkpoints as ckpt
from qjrl.learning.ppo import mesh as meshes
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.environment import ACTOR_KEY, State
from qjrl.learning.ppo.episodes import EpisodeLog
from qjrl.learning.ppo.normaliser import Normaliser
from qjrl.learning.ppo.policy import Policy
from qjrl.learning.ppo.update import Learner


@struct.dataclass
class TrainerState:
    """The learner, the same on every device, and the envs, dealt out. No leaf is float64."""

    learner: Learner
    normaliser: Normaliser
    key: Any
    """Of the next iteration."""
    iteration: Any
    """Iterations done, int32."""
    env_steps: Any
    """Environment steps taken over all envs, uint32."""
    envs: State
    episodes: EpisodeLog


def policy_of(trainer: TrainerState, config: PPOConfig) -> Policy:
    """The actor by itself, on the host."""
    layers = trainer.learner.parameters["policy"]["params"]
    layers, mean, std = meshes.on_host((layers, trainer.normaliser.mean, trainer.normaliser.std))
    return Policy(
        layers, mean[ACTOR_KEY], std[ACTOR_KEY], activation=config.activation, observation_clip=config.observation_clip
    )


@struct.dataclass
class Snapshot:
    """A trainer's state as plain arrays on the host: the learner's, and those of the envs of all processes."""

    learner: dict[str, Any]
    """All but the envs as nested dicts of arrays, the key as the numbers that it is made of."""
    envs: dict[str, np.ndarray]
    """Path in the pytree -> array, of `envs` and `episodes`, a row an env."""


def snapshot(trainer: TrainerState) -> Snapshot:
    """What a checkpoint holds; all processes take it together."""
    learner, envs = _apart(trainer)
    plain = serialization.to_state_dict(meshes.on_host(learner))
    # brax's counter makes arrays of a device of whatever it is given.
    return Snapshot(jax.tree.map(np.asarray, plain), _flat(meshes.on_host(envs)))


def restored(trainer: TrainerState, found: Snapshot, mesh: Mesh) -> TrainerState:
    """The trainer's state of a snapshot; `trainer` gives the structure."""
    learner, envs = (meshes.on_host(part) for part in _apart(trainer))
    learner = serialization.from_state_dict(learner, found.learner)
    key = jax.random.wrap_key_data(jnp.asarray(learner.pop("key")))
    placed = meshes.everywhere(mesh, learner | {"key": key})
    envs = meshes.dealt_out(mesh, _unflat(envs, found.envs))
    keys = jax.tree.map(_as_key, _apart(trainer)[1], envs)
    return TrainerState(**placed, **keys)


def write_snapshot(
    checkpoints: ocp.CheckpointManager, found: Snapshot, metrics: dict[str, float | None] | None
) -> None:
    """Writes a checkpoint of both sides."""
    ckpt.save(checkpoints, int(found.learner["iteration"]), found.learner, metrics, found.envs)


def read_snapshot(checkpoints: ocp.CheckpointManager, step: int, like: Snapshot) -> Snapshot:
    """Both sides of a checkpoint; `like` gives the learner's shapes."""
    return Snapshot(ckpt.restore(checkpoints, step, like.learner), ckpt.restore_environment(checkpoints, step))


def _apart(trainer: TrainerState) -> tuple[dict[str, Any], dict[str, Any]]:
    fields = {field.name: getattr(trainer, field.name) for field in dataclasses.fields(trainer)}
    envs = {name: fields.pop(name) for name in ("envs", "episodes")}
    return fields, envs


def _as_key(like: Any, leaf: jax.Array) -> jax.Array:
    return jax.random.wrap_key_data(leaf) if jnp.issubdtype(like.dtype, jax.dtypes.prng_key) else leaf


def _flat(tree: Any) -> dict[str, np.ndarray]:
    return {jax.tree_util.keystr(path, simple=True, separator="/"): leaf for path, leaf in _leaves(tree)}


def _unflat(like: Any, arrays: dict[str, np.ndarray]) -> Any:
    names = [jax.tree_util.keystr(path, simple=True, separator="/") for path, _ in _leaves(like)]
    return jax.tree.unflatten(jax.tree.structure(like), [arrays[name] for name in names])


def _leaves(tree: Any) -> list[tuple[Any, Any]]:
    return jax.tree_util.tree_leaves_with_path(tree)
