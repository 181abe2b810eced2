"""Limits of a robot's coordinates: what brings coordinates back within them, and which motions they leave.

Each shape of limits has `within`, which brings coordinates back, and `free_motions`, the Jacobian (rows, n, *batch) without
the motions that would leave the limits along `slope`, the way downhill.

Coordinates (n, *batch) come first and a batch of robots last, as in `qjrl.geometry.batch_last`.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

# Coordinates this close to a limit count as at it: what brings them back leaves them there to rounding.
_AT_LIMIT = 1.0 - 1e-6


@struct.dataclass
class Discs:
    """Pairs of coordinates, each pair within a disc about zero: joints that bend in every direction."""

    radius: jax.Array
    """()."""

    def within(self, coordinates: Float[Array, "n *batch"]) -> Float[Array, "n *batch"]:
        """Each pair shortened to the radius."""
        pairs, radius = _pairs(coordinates), self.radius.astype(coordinates.dtype)
        size = jnp.sqrt(jnp.maximum(jnp.sum(pairs**2, axis=1, keepdims=True), radius**2))
        return (pairs * (radius / size)).reshape(coordinates.shape)

    def free_motions(
        self,
        coordinates: Float[Array, "n *batch"],
        slope: Float[Array, "n *batch"],
        jacobian: Float[Array, "rows n *batch"],
    ) -> Float[Array, "rows n *batch"]:
        """Without the radial motion of pairs on their disc's edge that `slope` would carry outward."""
        pairs, downhill = _pairs(coordinates), _pairs(slope)
        motions = jacobian.reshape(len(jacobian), *pairs.shape)  # (rows, pairs, 2, *batch)
        edge, squared = (self.radius * _AT_LIMIT) ** 2, jnp.sum(pairs**2, axis=1)
        is_held = (squared >= edge) & (jnp.sum(downhill * pairs, axis=1) > 0)
        outward = pairs * jnp.where(is_held, 1.0 / jnp.maximum(squared, edge), 0.0)[:, None]
        radial = jnp.sum(motions * pairs, axis=2, keepdims=True)  # (rows, pairs, 1, *batch)
        return (motions - radial * outward).reshape(jacobian.shape)


@struct.dataclass
class Box:
    """Every coordinate between two bounds of its own."""

    low: Float[Array, "n"]
    high: Float[Array, "n"]

    def within(self, coordinates: Float[Array, "n *batch"]) -> Float[Array, "n *batch"]:
        """Each coordinate clipped."""
        low, high = self._bounds(coordinates)
        return jnp.clip(coordinates, low, high)

    def free_motions(
        self,
        coordinates: Float[Array, "n *batch"],
        slope: Float[Array, "n *batch"],
        jacobian: Float[Array, "rows n *batch"],
    ) -> Float[Array, "rows n *batch"]:
        """Without the columns of coordinates at a bound that `slope` would carry beyond it."""
        low, high = self._bounds(coordinates)
        margin = (1.0 - _AT_LIMIT) * (high - low)
        is_held = ((coordinates >= high - margin) & (slope > 0)) | ((coordinates <= low + margin) & (slope < 0))
        return jnp.where(is_held[None], 0.0, jacobian)

    def _bounds(self, like: jax.Array) -> tuple[jax.Array, jax.Array]:
        shape = (-1, *[1] * (like.ndim - 1))
        return self.low.reshape(shape).astype(like.dtype), self.high.reshape(shape).astype(like.dtype)


Limits = Discs | Box


def _pairs(coordinates: jax.Array) -> jax.Array:
    return coordinates.reshape(-1, 2, *coordinates.shape[1:])
