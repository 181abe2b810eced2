"""Domain randomisation: what differs between the robot of the model and the robot at hand (paper 000, section 4)."""

import math
from typing import Annotated

import jax
import jax.numpy as jnp

from qjrl.config import Range, configuration
from qjrl.robot.plant import PhysicalParameters
from qjrl.robot.verbs import Robot

Interval = tuple[Annotated[float, Range(low=0.0)], Annotated[float, Range(low=0.0)]]
Periods = Annotated[int, Range(0, 100)]

_SCALES = ("strand_damping_scale", "armature_scale", "gain_scale", "strand_stiffness_scale")


@configuration
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
    least_tilt_deg: Annotated[float, Range(0.0, 90.0)] = 0.0
    """Of the base [deg]; equal to the largest for a tilt of just that, in any direction."""
    strand_stiffness_scale: Interval = (1.0, 1.0)
    """Times the stiffness of every strand by itself, on top of the gain, uniform in the logarithm; off."""
    payload: Interval = (0.0, 0.0)
    """Mass at the tip [kg], on top of the robot's; off."""
    backlash: Interval = (0.0, 0.0)
    """Half the width of the dead band between motors and cables [m]; off."""
    delay: tuple[Periods, Periods] = (0, 0)
    """Whole control periods that a command takes to the motors; off."""
    dead_encoder_share: Annotated[float, Range(0.0, 1.0)] = 0.0
    """Of the arms that have a joint whose encoders read no bend, one of all joints at random; off."""

    def __post_init__(self):
        for name in (*_SCALES, "strand_friction", "payload", "backlash", "delay"):
            low, high = getattr(self, name)
            if low > high or (name in _SCALES and low <= 0.0):
                least = "0 <" if name in _SCALES else "0 <="
                raise ValueError(f"{name}: got [{low}, {high}], allowed: [low, high] with {least} low <= high")
        if self.least_tilt_deg > self.largest_tilt_deg:
            raise ValueError(
                f"least_tilt_deg: got {self.least_tilt_deg}, allowed: at most largest_tilt_deg {self.largest_tilt_deg}"
            )


def draw_parameters(config: RandomisationConfig, robot: Robot, key: jax.Array) -> PhysicalParameters:
    """Physical parameters of one arm."""
    key_damping, key_friction, key_armature, key_gain, key_tilt, key_direction, key_strands, key_payload = (
        jax.random.split(key, 8)
    )
    inner = (config.least_tilt_deg / max(config.largest_tilt_deg, 1e-9)) ** 2
    tilt = math.radians(config.largest_tilt_deg) * jnp.sqrt(inner + (1.0 - inner) * jax.random.uniform(key_tilt))
    direction = 2.0 * jnp.pi * jax.random.uniform(key_direction)
    return PhysicalParameters(
        strand_damping_scale=_log_uniform(key_damping, config.strand_damping_scale),
        strand_friction=_uniform(key_friction, config.strand_friction),
        armature_scale=_log_uniform(key_armature, config.armature_scale),
        gain_scale=_log_uniform(key_gain, config.gain_scale),
        tilt=tilt * jnp.stack([jnp.cos(direction), jnp.sin(direction)]),
        strand_stiffness_scale=_log_uniform(key_strands, config.strand_stiffness_scale, (robot.num_strands,)),
        payload=robot.payload + _uniform(key_payload, config.payload),
    )


def _uniform(key: jax.Array, interval: Interval) -> jax.Array:
    low, high = interval
    return low + (high - low) * jax.random.uniform(key)


def _log_uniform(key: jax.Array, interval: Interval, shape: tuple[int, ...] = ()) -> jax.Array:
    low, high = interval
    return low * (high / low) ** jax.random.uniform(key, shape)
