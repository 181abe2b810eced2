"""From base command and residual to what the motors do: ramp, bounded residual, one speed limiter."""

import dataclasses
from typing import Annotated

import jax
import jax.numpy as jnp

from qjrl.config import Range
from qjrl.robot.verbs import Robot


@dataclasses.dataclass(frozen=True)
class ResidualConfig:
    """How an action becomes an offset of the cable lengths."""

    rate: Annotated[float, Range(above=0.0)] = 0.0025
    """Fastest change of the residual [m/s] at an action of 1; below the motors' 0.0314. Ours: 0.05 mm a control step."""
    bound: Annotated[float, Range(above=0.0)] = 0.003
    """Largest residual of a cable [m], ours: a few times the base's error. The paper's is 0.020, anew at every step."""


def ramp_time(robot: Robot, base_lengths: jax.Array) -> jax.Array:
    """Time [s] in which the base command is ramped in from home: its longest cable (num_cables,) [m] at motor speed."""
    return jnp.max(jnp.abs(base_lengths)) / robot.motor_speed


def ramped_base(robot: Robot, base_lengths: jax.Array, time: jax.Array) -> jax.Array:
    """Base command (num_cables,) [m] at a time [s] since the start: straight from home, so the bends stay within limits."""
    duration = jnp.maximum(ramp_time(robot, base_lengths), 1e-9)
    return base_lengths * jnp.minimum(time / duration, 1.0)


def move_residual(config: ResidualConfig, residual: jax.Array, action: jax.Array, period: float) -> jax.Array:
    """Residual (num_cables,) [m] after one control period [s] under an action in [-1, 1]."""
    return jnp.clip(residual + jnp.clip(action, -1.0, 1.0) * config.rate * period, -config.bound, config.bound)


def limit_speed(robot: Robot, command: jax.Array, desired: jax.Array, period: float) -> jax.Array:
    """Motor command (num_cables,) [m] one period later: towards `desired`, at most at motor speed."""
    largest = robot.motor_speed * period
    return command + jnp.clip(desired - command, -largest, largest)
