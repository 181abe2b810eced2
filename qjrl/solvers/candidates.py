"""Random poses for descents to start from: those nearest to a target by weighted pose error."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.robot.batching import in_batches
from qjrl.robot.kinds import kind_of
from qjrl.robot.verbs import Robot


@struct.dataclass
class Candidates:
    """Poses to start from."""

    coordinates: np.ndarray
    """(candidates, coordinates) of the robot's kind."""
    features: np.ndarray
    """(candidates, 9) their poses scaled so that squared distances compare like squared weighted errors [m]."""


def random_candidates(robot: Robot, count: int, rotation_weight: float, seed: int) -> Candidates:
    """Poses all over the workspace; what a rotation counts against a position [m/rad]."""
    coordinates, poses = _random_poses(robot, jax.random.key(seed), count)
    return Candidates(np.asarray(coordinates), _features(np.asarray(poses), rotation_weight))


def nearest_candidates(
    candidates: Candidates, rotation_weight: float, targets: np.ndarray, used: int, count: int
) -> np.ndarray:
    """The candidates that rank `used` ... `used + count` by distance to each target, (rows, count)."""
    features = _features(targets, rotation_weight)
    if (used, count) == (0, 1):
        function = functools.partial(_nearest_rows, candidates.features)
        return in_batches(function, _RANKED_TOGETHER, features)[:, None]
    if count == 0:
        return np.empty((len(targets), 0), int)
    ranks = (used + np.arange(count)) % len(candidates.features)
    squares = (np.sum((row - candidates.features) ** 2, axis=1) for row in features)
    return np.stack([np.argsort(row)[ranks] for row in squares])


@jax.jit
def _nearest_rows(candidates: jax.Array, targets: jax.Array) -> jax.Array:
    """Index of the nearest candidate; the maximum over a mask, since XLA's argmin is slow on a CPU."""
    distances = 0.5 * jnp.sum(candidates**2, axis=1) - targets @ candidates.T
    is_nearest = distances <= jnp.min(distances, axis=1, keepdims=True)
    return jnp.max(jnp.where(is_nearest, jnp.arange(len(candidates), dtype=jnp.int32), 0), axis=1)


def _features(poses: np.ndarray, rotation_weight: float) -> np.ndarray:
    """Frames an angle e apart differ by e in their columns, so these differ by the weighted error; single precision."""
    return np.concatenate([poses[:, :3], rotation_weight * poses[:, 3:]], axis=1).astype(np.float32)


@functools.partial(jax.jit, static_argnums=2)
def _random_poses(robot: Robot, key: jax.Array, count: int):
    kind = kind_of(robot)

    def draw(one: jax.Array) -> tuple[jax.Array, jax.Array]:
        configuration = kind.random(robot, one)
        return kind.coordinates_of(robot, configuration), kind.forward_kinematics(robot, configuration)

    return jax.vmap(draw)(jax.random.split(key, count))


# Targets whose distances to all candidates fit into a core's cache.
_RANKED_TOGETHER = 128
