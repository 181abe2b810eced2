"""The pose as 9 numbers: position [m], then the first and the second column of the rotation."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from qjrl.geometry.rotations import geodesic_angle, orthonormalise, rotation_vector, safe_norm


def pose_from_frame(position: Float[Array, "3"], rotation: Float[Array, "3 3"]) -> Float[Array, "9"]:
    """Pack a position [m] and a rotation matrix into a pose."""
    return jnp.concatenate([position, rotation[:, 0], rotation[:, 1]])


def position_of(pose: Float[Array, "9"]) -> Float[Array, "3"]:
    """Position of a pose [m]."""
    return pose[:3]


def rotation_of(pose: Float[Array, "9"]) -> Float[Array, "3 3"]:
    """Rotation matrix of a pose, its columns orthonormalised (exact for a true pose)."""
    return orthonormalise(pose[3:].reshape(2, 3))


def position_error(pose: Float[Array, "9"], target: Float[Array, "9"]) -> Float[Array, ""]:
    """Euclidean distance of two positions [m]."""
    return safe_norm(pose[:3] - target[:3])


def orientation_error(pose: Float[Array, "9"], target: Float[Array, "9"]) -> Float[Array, ""]:
    """Geodesic angle between two orientations [rad]."""
    return geodesic_angle(rotation_of(pose), rotation_of(target))


def pose_difference(pose: Float[Array, "9"], target: Float[Array, "9"]) -> Float[Array, "6"]:
    """What a pose lacks of a target: the shift [m], then the rotation vector [rad], both in the base frame."""
    turn = rotation_of(target) @ rotation_of(pose).T
    return jnp.concatenate([position_of(target) - position_of(pose), rotation_vector(turn)])


def row_errors(
    poses: Float[ArrayLike, "n 9"], targets: Float[ArrayLike, "n 9"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Position [m] and orientation [rad] error of every row, on the host."""
    position, orientation = _row_errors(jnp.asarray(poses), jnp.asarray(targets))
    return np.asarray(position), np.asarray(orientation)


@jax.jit
def _row_errors(poses: jax.Array, targets: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jax.vmap(position_error)(poses, targets), jax.vmap(orientation_error)(poses, targets)
