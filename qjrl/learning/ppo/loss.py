"""The clipped surrogate of PPO, on rows that carry a weight."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.learning.ppo.brax_parts import PPONetworks
from qjrl.learning.ppo.config import PPOConfig


@struct.dataclass
class Batch:
    """Rows of experience, (rows, ...), float32."""

    observation: Any
    raw_action: Any
    logits: Any
    """Of the policy that acted."""
    log_probability: Any
    advantage: Any
    """Normalised."""
    returns: Any
    weight: Any
    """1, or 0 for a row that is not valid."""


def ppo_loss(
    parameters: Any, normaliser: Any, batch: Batch, key: jax.Array, networks: PPONetworks, config: PPOConfig
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """-E[min(rho A, clip(rho) A)] + c_v/2 E[(V - R)^2] - c_e H, means over the valid rows.

    Own, not brax's `compute_ppo_loss`: that one masks truncated steps and knows no weights. Source: Schulman et al.
    2017, equations 7 and 9.
    """
    distribution: Any = networks.parametric_action_distribution

    def mean(rows: jax.Array) -> jax.Array:
        return jnp.sum(batch.weight * rows) / jnp.maximum(jnp.sum(batch.weight), 1.0)

    logits = networks.policy_network.apply(normaliser, parameters["policy"], batch.observation)
    log_ratio = distribution.log_prob(logits, batch.raw_action) - batch.log_probability
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1 - config.clipping, 1 + config.clipping)
    policy_loss = -mean(jnp.minimum(ratio * batch.advantage, clipped * batch.advantage))

    values = networks.value_network.apply(normaliser, parameters["value"], batch.observation)
    value_loss = 0.5 * mean(jnp.square(values - batch.returns))
    entropy = mean(distribution.entropy(logits, key).astype(jnp.float32))  # brax samples in float64 under x64
    loss = policy_loss + config.value_coefficient * value_loss - config.entropy_cost * entropy

    new, old = distribution.create_dist(logits), distribution.create_dist(batch.logits)
    return loss, {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        "kl": mean(new.kl_divergence(old)),
        "std": mean(new.scale.mean(axis=-1)),
        "clip_fraction": mean(jnp.abs(ratio - 1) > config.clipping),
    }
