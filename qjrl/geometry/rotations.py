"""Rotation matrices: elementary rotations, the geodesic angle, and the frame nearest to two columns."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def rotation_x(angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    """Rotation about x by `angle` [rad]."""
    c, s, o, i = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle), jnp.ones_like(angle)
    return jnp.array([[i, o, o], [o, c, -s], [o, s, c]])


def rotation_y(angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    """Rotation about y by `angle` [rad]."""
    c, s, o, i = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle), jnp.ones_like(angle)
    return jnp.array([[c, o, s], [o, i, o], [-s, o, c]])


def rotation_z(angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    """Rotation about z by `angle` [rad]."""
    c, s, o, i = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle), jnp.ones_like(angle)
    return jnp.array([[c, -s, o], [s, c, o], [o, o, i]])


def safe_norm(vector: Float[Array, "*n"]) -> Float[Array, ""]:
    """Euclidean norm whose gradient at the zero vector is zero instead of NaN."""
    squared = jnp.sum(vector**2)
    is_zero = squared == 0.0
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, squared)))


def geodesic_angle(rotation_a: Float[Array, "3 3"], rotation_b: Float[Array, "3 3"]) -> Float[Array, ""]:
    """Angle of the rotation that takes frame a to frame b [rad], in [0, pi].

    Through atan2 of sine and cosine: acos alone has a floor of 0.02 degrees in float32.
    """
    relative = rotation_a.T @ rotation_b
    twice_sine = safe_norm(_vee(relative - relative.T))
    return jnp.arctan2(twice_sine, jnp.trace(relative) - 1.0)


def rotation_vector(rotation: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Axis times angle [rad] of a rotation; smooth at none, and undefined at half a turn."""
    twice_sine = _vee(rotation - rotation.T)
    sine = safe_norm(twice_sine) / 2.0
    angle = jnp.arctan2(sine, (jnp.trace(rotation) - 1.0) / 2.0)
    ratio = jnp.where(sine > 1e-6, angle / jnp.maximum(sine, 1e-6), 1.0)
    return twice_sine * ratio / 2.0


def orthonormalise(columns: Float[Array, "2 3"]) -> Float[Array, "3 3"]:
    """Rotation whose first columns are nearest (Gram-Schmidt) to two given 3-vectors.

    Args:
        columns: first and second column of a matrix that need not be orthonormal (a network's output).
    """
    x = columns[0] / jnp.maximum(safe_norm(columns[0]), _TINY)
    y = columns[1] - jnp.dot(x, columns[1]) * x
    y = y / jnp.maximum(safe_norm(y), _TINY)
    return jnp.stack([x, y, jnp.cross(x, y)], axis=1)


def _vee(skew: Float[Array, "3 3"]) -> Float[Array, "3"]:
    return jnp.stack([skew[2, 1], skew[0, 2], skew[1, 0]])


# Keeps degenerate columns finite; far below any length a unit column can lose to rounding.
_TINY = 1e-12
