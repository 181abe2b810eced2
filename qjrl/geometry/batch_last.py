"""Vectors (3, *batch) and matrices (3, n, *batch) of many arms at once: components first and the batch last, so that each
component is one long row for the processor. Written out instead of one small product an arm."""

import functools

import jax
import jax.numpy as jnp


def from_rows(*rows) -> jax.Array:
    """Matrix of rows of entries, each (*batch)."""
    return jnp.stack([jnp.stack(row) for row in rows])


def identity_like(matrix: jax.Array) -> jax.Array:
    """The identity, as many as `matrix` (3, 3, *batch) holds."""
    return jnp.zeros_like(matrix) + jnp.eye(3, dtype=matrix.dtype).reshape(3, 3, *[1] * (matrix.ndim - 2))


def cross(a: jax.Array, b: jax.Array) -> jax.Array:
    """Cross product of (3, ...) and (3, ...)."""
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def dot(a: jax.Array, b: jax.Array) -> jax.Array:
    """Scalar product of (3, ...) and (3, ...)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def times(matrix: jax.Array, vector: jax.Array) -> jax.Array:
    """Matrix (3, n, ...) times vector (n, ...)."""
    terms = [matrix[:, column] * vector[column] for column in range(len(vector))]
    return functools.reduce(jnp.add, terms)


def product(matrix: jax.Array, other: jax.Array) -> jax.Array:
    """Matrix (3, 3, ...) times matrix (3, n, ...)."""
    return jnp.stack([times(matrix, other[:, column]) for column in range(other.shape[1])], axis=1)


def rotation_vector(rotation: jax.Array, target: jax.Array) -> jax.Array:
    """Logarithm of target rotation^T (3, 3, *batch): axis times angle in the base frame [rad]; undefined at half a turn."""
    relative = jnp.sum(target[:, None] * rotation[None], axis=2)
    sine_axis = 0.5 * jnp.stack(
        [relative[2, 1] - relative[1, 2], relative[0, 2] - relative[2, 0], relative[1, 0] - relative[0, 1]]
    )
    squared = jnp.sum(sine_axis**2, axis=0)
    is_straight = squared < _TINY  # angle near 0, where angle / sine is 1, or near 180 degrees, where no axis is known
    sine = jnp.sqrt(jnp.where(is_straight, 1.0, squared))
    cosine = 0.5 * (relative[0, 0] + relative[1, 1] + relative[2, 2] - 1.0)
    return sine_axis * jnp.where(is_straight, 1.0, jnp.arctan2(sine, cosine) / sine)


# Squared sine of 1e-6 rad.
_TINY = 1e-12
