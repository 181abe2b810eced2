"""Small symmetric systems, many at once: components first and the batch last, written out instead of one LAPACK call each."""

from typing import Any

import jax
import jax.numpy as jnp


def factor(matrix: Any) -> list[list[jax.Array]]:
    """Rows of L with L L^T = matrix, positive definite, of which the lower triangle counts; the diagonal holds 1 / L_jj.

    Args:
        matrix: entries [i][j], each (*batch).
    """
    size = len(matrix)
    lower = [[jnp.zeros_like(matrix[0][0])] * (row + 1) for row in range(size)]
    for j in range(size):
        inverse = jax.lax.rsqrt(matrix[j][j] - sum(lower[j][k] ** 2 for k in range(j)))
        lower[j][j] = inverse
        for i in range(j + 1, size):
            lower[i][j] = (matrix[i][j] - sum(lower[i][k] * lower[j][k] for k in range(j))) * inverse
    return lower


def solve(lower: list[list[jax.Array]], right: jax.Array) -> jax.Array:
    """x (n, ..., *batch) with L L^T x = right, L as `factor` gives it."""
    return jnp.stack(back(lower, forward(lower, right)))


def forward(lower: list[list[jax.Array]], right: Any) -> list[jax.Array]:
    """Rows of L^-1 right (n, ..., *batch), L as `factor` gives it."""
    found: list[jax.Array] = []
    for i in range(len(right)):
        found.append((right[i] - sum(lower[i][k] * found[k] for k in range(i))) * lower[i][i])
    return found


def back(lower: list[list[jax.Array]], right: Any) -> list[jax.Array]:
    """Rows of L^-T right (n, ..., *batch), L as `factor` gives it."""
    size = len(right)
    found = [right[0]] * size
    for i in reversed(range(size)):
        found[i] = (right[i] - sum(lower[k][i] * found[k] for k in range(i + 1, size))) * lower[i][i]
    return found
