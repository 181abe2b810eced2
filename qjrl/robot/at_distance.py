"""A configuration whose tip is at a given distance from its place at home: the law of the paper's test poses (paper 000)."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# Halvings of the scale of a direction: 1 / 2^40 of the limit.
_BISECTIONS = 40


def scaled_to_distance(
    pose_of: Callable[[jax.Array], jax.Array], largest: Float[Array, "*shape"], distance: Float[Array, ""]
) -> Float[Array, "*shape"]:
    """A configuration, home being zero, scaled down until the tip is `distance` [m] away from its home.

    Args:
        pose_of: configuration -> pose (9,).
        largest: the largest feasible configuration in its direction; returned where it does not reach so far.
    """
    home = pose_of(jnp.zeros_like(largest))[:3]

    def halve(_, bounds):
        low, high = bounds
        middle = (low + high) / 2.0
        is_short = jnp.linalg.norm(pose_of(middle * largest)[:3] - home) < distance
        return jnp.where(is_short, middle, low), jnp.where(is_short, high, middle)

    _, scale = jax.lax.fori_loop(0, _BISECTIONS, halve, (jnp.zeros(()), jnp.ones(())))
    return scale * largest
