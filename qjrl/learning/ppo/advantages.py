"""Generalised advantage estimation with time limits and diverged steps."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from qjrl.learning.ppo.brax_parts import compute_gae


def advantages_and_returns(
    rollout: Any,
    values: Float[Array, "steps envs"],
    last_value: Float[Array, " envs"],
    final_values: Float[Array, "steps envs"],
    discount: float,
    gae_lambda: float,
) -> tuple[Float[Array, "steps envs"], Float[Array, "steps envs"]]:
    """A_t = sum over l of (gamma lambda)^l delta_{t+l} within an episode; delta = r + gamma V(next) - V.

    V(next) is 0 where the episode terminated, and the value of the final observation where the time limit cut it off
    (Pardo et al. 2018, "Time limits in reinforcement learning"): reaching episodes always end by time limit, and
    their steps must not be thrown away (brax's default) or taken for failures. It is added to the reward, and the
    step then counts as an end. A step that is not valid has no advantage, and the step before it looks ahead to the
    value of the state in which it started: brax's way with truncation.

    Args:
        rollout: `reward` (scaled), `terminated`, `truncated`, `valid`, (steps, envs).
        values: (steps, envs) of the observations acted on.
        last_value: (envs,) of the observation after the last step.
        final_values: (steps, envs) of the final observations where `truncated`; elsewhere unused.
    Returns:
        Advantages and returns (advantage + value), (steps, envs) float32. Not brax's advantages: those weigh the
        second delta by gamma instead of gamma lambda (0.14.2, losses.py); its returns are the usual ones.
    """
    reward = rollout.reward + discount * jnp.where(rollout.truncated, final_values, 0.0)
    returns, _ = compute_gae(
        truncation=1.0 - rollout.valid.astype(jnp.float32),
        termination=(rollout.terminated | rollout.truncated).astype(jnp.float32),
        rewards=reward,
        values=values,
        bootstrap_value=last_value,
        lambda_=gae_lambda,
        discount=discount,
    )
    return returns - values, returns
