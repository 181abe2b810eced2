"""Domain randomisation: what differs between the robot of the model and the robot at hand (paper 000, section 4)."""

import dataclasses
import math
from typing import Annotated

import jax
import jax.numpy as jnp

from qjrl.config import Range

Interval = tuple[Annotated[float, Range(low=0.0)], Annotated[float, Range(low=0.0)]]


@dataclasses.dataclass(frozen=True)
class RandomisationConfig:
    """Ranges, uniform unless said otherwise. The paper names the quantities; the ranges are ours."""

    strand_damping_scale: Interval = (0.5, 3.0)
    """Times the robot's strand damping, uniform in the logarithm."""
    strand_friction: Interval = (0.0, 3.0)
    """Dry friction along every strand [N]; it sticks."""
    armature_scale: Interval = (0.5, 2.0)
    """Times the rotor inertia, uniform in the logarithm."""
    gain_scale: Interval = (0.8, 1.25)
    """Times the position gain of the strand servos, uniform in the logarithm."""
    largest_tilt_deg: Annotated[float, Range(0.0, 90.0)] = 5.0
    """Of the base, in any direction [deg]."""
    encoder_noise_deg: Annotated[float, Range(0.0, 45.0)] = 0.25
    """Standard deviation of a joint's encoder [deg]: five times the nominal 0.05 (paper 000, section 5.4.2)."""

    def __post_init__(self):
        for name in ("strand_damping_scale", "strand_friction", "armature_scale", "gain_scale"):
            low, high = getattr(self, name)
            if low > high or (name != "strand_friction" and low <= 0.0):
                raise ValueError(f"{name}: got [{low}, {high}], allowed: [low, high] with 0 < low <= high")


def draw_parameters(config: RandomisationConfig, key: jax.Array) -> dict[str, jax.Array]:
    """Physical parameters of one arm, by the names of `simulation.stepping.PhysicalParameters`."""
    key_damping, key_friction, key_armature, key_gain, key_tilt, key_direction = jax.random.split(key, 6)
    tilt = math.radians(config.largest_tilt_deg) * jnp.sqrt(jax.random.uniform(key_tilt))
    direction = 2.0 * jnp.pi * jax.random.uniform(key_direction)
    low, high = config.strand_friction
    return {
        "strand_damping_scale": _log_uniform(key_damping, config.strand_damping_scale),
        "strand_friction": low + (high - low) * jax.random.uniform(key_friction),
        "armature_scale": _log_uniform(key_armature, config.armature_scale),
        "gain_scale": _log_uniform(key_gain, config.gain_scale),
        "tilt": tilt * jnp.stack([jnp.cos(direction), jnp.sin(direction)]),
    }


def _log_uniform(key: jax.Array, interval: Interval) -> jax.Array:
    low, high = interval
    return low * (high / low) ** jax.random.uniform(key)
