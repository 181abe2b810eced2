"""Running mean and standard deviation of the observations: brax's, kept in float32."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from qjrl.learning.ppo.brax_parts import running_statistics

Normaliser = running_statistics.RunningStatisticsState


def initial_normaliser(observation_sizes: Mapping[str, int]) -> Normaliser:
    """Mean 0, standard deviation 1. brax makes it float64 under x64, and its epsilon a Python float: cast both."""
    shapes = {name: jax.ShapeDtypeStruct((size,), jnp.float32) for name, size in observation_sizes.items()}
    return jax.tree.map(_float32, running_statistics.init_state(shapes))


def update_normaliser(normaliser: Normaliser, observation: Mapping[str, Any], valid: Any) -> Normaliser:
    """Takes in the valid rows of a rollout.

    Args:
        observation: name -> (steps, envs, n) float32, finite everywhere.
        valid: (steps, envs) bool; the other rows have no weight.
    """
    weights = jnp.asarray(valid, jnp.float32)
    return jax.tree.map(_float32, running_statistics.update(normaliser, dict(observation), weights=weights))


def _float32(leaf: Any) -> jax.Array:
    leaf = jnp.asarray(leaf)
    return leaf.astype(jnp.float32) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf
