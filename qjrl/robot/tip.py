"""Pose of the tip and how it moves with a robot's coordinates: what descents on any kind of robot work on."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from qjrl.geometry.pose import position_of, rotation_of


@struct.dataclass
class Tip:
    """Pose of the tip in the base frame, and its Jacobian; a batch of robots comes last."""

    position: Float[Array, "3 *batch"]
    """[m]."""
    rotation: Float[Array, "3 3 *batch"]
    velocity: Float[Array, "3 coordinates *batch"]
    """d position / d coordinate, [m/rad] where coordinates are angles."""
    angular_velocity: Float[Array, "3 coordinates *batch"]
    """Of the tip in the base frame, for each unit of a coordinate [rad]."""


def tip_by_differentiation(
    pose_of: Callable[[jax.Array], jax.Array], coordinates: Float[Array, "coordinates *batch"]
) -> Tip:
    """The tip of any function coordinates (n,) -> pose (9,), its Jacobian by one pass for every coordinate."""
    if coordinates.ndim > 1:
        return jax.vmap(lambda one: tip_by_differentiation(pose_of, one), in_axes=-1, out_axes=-1)(coordinates)

    def frame(one: jax.Array) -> tuple[jax.Array, jax.Array]:
        pose = pose_of(one)
        return position_of(pose), rotation_of(pose)

    position, rotation = frame(coordinates)
    velocity, rate = jax.jacfwd(frame)(coordinates)
    turning = 0.5 * jnp.sum(jnp.cross(rotation[..., None], rate, axis=0), axis=1)  # of each column r: r x dr / 2
    return Tip(position, rotation, velocity, turning)
