"""Reward of one control step: nothing while the base is ramped in, then how near the tip is to its target."""

from typing import Annotated

import jax
import jax.numpy as jnp

from qjrl.config import Range, configuration


@configuration
class RewardConfig:
    """Weights and scales, all ours; paper 000 (section 5.4.2) has the exponentials and the bonus, without numbers."""

    position_scale: Annotated[float, Range(above=0.0)] = 0.0005
    """Position error at which the position term has fallen to 1/e [m]."""
    orientation_scale: Annotated[float, Range(above=0.0)] = 0.003
    """Orientation error at which the orientation term has fallen to 1/e [rad]."""
    orientation_weight: Annotated[float, Range(low=0.0)] = 0.5
    """Of the orientation term; the position term's is 1."""
    distance_weight: Annotated[float, Range(low=0.0)] = 0.05
    """Cost of each position scale of error: a slope far from the target."""
    action_weight: Annotated[float, Range(low=0.0)] = 0.02
    """Cost of the mean squared action."""
    bonus: Annotated[float, Range(low=0.0)] = 0.0
    """For a tip within both of the next."""
    bonus_position: Annotated[float, Range(above=0.0)] = 0.005
    """[m]."""
    bonus_orientation: Annotated[float, Range(above=0.0)] = 0.0175
    """[rad]; 1 degree."""


def reward(
    config: RewardConfig,
    position_error: jax.Array,
    orientation_error: jax.Array,
    action: jax.Array,
    has_arrived: jax.Array,
) -> jax.Array:
    """Reward of a step from position error [m], orientation error [rad] and action; 0 before the ramp has ended."""
    near = jnp.exp(-position_error / config.position_scale)
    aligned = config.orientation_weight * jnp.exp(-orientation_error / config.orientation_scale)
    far = config.distance_weight * jnp.minimum(position_error / config.position_scale, 20.0)
    is_success = (position_error < config.bonus_position) & (orientation_error < config.bonus_orientation)
    effort = config.action_weight * jnp.mean(action**2)
    return jnp.where(has_arrived, near + aligned - far + config.bonus * is_success, 0.0) - effort
