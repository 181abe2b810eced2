"""By how much poses miss the waypoints of a path, in what counts of them."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.control.path.paths import ROTATION_WEIGHT, Constraint
from qjrl.geometry.pose import rotation_of
from qjrl.geometry.rotations import geodesic_angle, safe_norm


def path_errors(constraint: Constraint, poses, targets) -> tuple[np.ndarray, np.ndarray]:
    """Position [m] and orientation [rad] error (n,) of poses (n, 9), of what counts; 0 for what does not."""
    position, orientation = _row_errors(constraint, jnp.asarray(poses), jnp.asarray(targets))
    return np.asarray(position), np.asarray(orientation)


@functools.partial(jax.jit, static_argnums=0)
def _row_errors(constraint: Constraint, poses: jax.Array, targets: jax.Array):
    return jax.vmap(functools.partial(counted_errors, constraint))(poses, targets)


def counted_errors(constraint: Constraint, pose: jax.Array, target: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Position [m] and orientation [rad] error of one pose (9,), of what counts."""
    position, rotation, wanted = safe_norm(pose[:3] - target[:3]), rotation_of(pose), rotation_of(target)
    if constraint == "pose":
        return position, geodesic_angle(rotation, wanted)
    if constraint == "pointing":
        z, wanted_z = rotation[:, 2], wanted[:, 2]
        return position, jnp.arctan2(safe_norm(jnp.cross(z, wanted_z)), z @ wanted_z)
    return position, jnp.zeros_like(position)


def pose_residual(constraint: Constraint, pose: jax.Array, target: jax.Array) -> jax.Array:
    """What is to vanish [m]: differences of positions and of the axes that count, which vanish at the target alone."""
    rotation, wanted, position = rotation_of(pose), rotation_of(target), pose[:3] - target[:3]
    columns = {"pose": [0, 1], "pointing": [2], "position": []}[constraint]
    turns = [ROTATION_WEIGHT * (rotation[:, column] - wanted[:, column]) for column in columns]
    return jnp.concatenate([position, *turns])
