"""From base command and residual to what the motors do: ramp, bounded residual, limits of stroke and speed."""

import math
from typing import Annotated, Literal

import jax
import jax.numpy as jnp

from qjrl.config import Range, configuration
from qjrl.robot.verbs import Robot, cable_strokes


@configuration
class ResidualConfig:
    """How an action becomes an offset of the cable lengths."""

    space: Literal["tip", "cables"] = "tip"
    """What an action moves: the tip, through the model's Jacobian (six numbers, ours), or the cables (paper 000, section 4)."""
    bound: Annotated[float, Range(above=0.0)] = 0.003
    """Offset [m] at an action of 1, of the tip or of a cable; an orientation counts with `LEVER`. The paper's is 0.020."""
    rate: Annotated[float, Range(above=0.0)] = 0.01
    """Fastest change of the offset [m/s], ours. The paper's moves by its whole bound at every step: 1.0."""
    lag: Annotated[float, Range(low=0.0)] = 0.05
    """Time constant [s] with which the offset follows the action, ours; the paper's is 0."""


@configuration
class DitherConfig:
    """Shaking off the friction: once the base command is ramped in, every motor swings about it, less and less.

    Dry friction holds a strand short of where its spring would let it rest, always against the way it came. Swings that
    die away slowly leave it in the middle, as they leave a magnet without magnetisation. Whatever moves the cables later,
    feedback or a policy, brings friction back, so that the swings grow again by as much as the cables are moved; the
    longer ago the ramp ended, the less, so that noise in the feedback does not keep them alive. All values ours.
    """

    amplitude: Annotated[float, Range(low=0.0)] = 0.0005
    """Largest swing of a cable [m], that after the ramp; 0 switches it off. Motors too slow for it swing less at first."""
    growth: Annotated[float, Range(low=0.0)] = 8.0
    """What the swings grow by for each metre that the cables are moved otherwise."""
    decay: Annotated[float, Range(above=0.0)] = 0.3
    """Time in which the swings fall to 1/e [s]."""
    lifetime: Annotated[float, Range(above=0.0)] = 0.8
    """Time [s] since the ramp's end in which the largest swing falls to 1/e."""
    half_period: Annotated[float, Range(above=0.0)] = 0.02
    """Time between two reversals [s]."""


def ramp_time(robot: Robot, base_lengths: jax.Array) -> jax.Array:
    """Time [s] in which the base command is ramped in from home: its longest cable (num_cables,) [m] at motor speed."""
    return jnp.max(jnp.abs(base_lengths)) / robot.motor_speed


def ramped_base(robot: Robot, base_lengths: jax.Array, time: jax.Array) -> jax.Array:
    """Base command (num_cables,) [m] at a time [s] since the start: straight from home, so the bends stay within limits."""
    duration = jnp.maximum(ramp_time(robot, base_lengths), 1e-9)
    return base_lengths * jnp.minimum(time / duration, 1.0)


def smoothed(config: DitherConfig, trend: jax.Array, added: jax.Array, period: float) -> jax.Array:
    """What feedback or a policy adds to the cables (num_cables,) [m], smoothed over the `decay` of the swings.

    An answer to the swings themselves has their short period; it may not feed them, or they never die away.
    """
    return trend + (1.0 - math.exp(-period / config.decay)) * (added - trend)


def next_swing(
    config: DitherConfig, amplitude: jax.Array, swing: jax.Array, moved: jax.Array, waited: jax.Array, period: float
) -> jax.Array:
    """Swing [m] one control period [s] later, a time [s] after the ramp's end, at most `amplitude` [m]: the cables
    (num_cables,) [m] were `moved` by all but the dither."""
    grown = swing * math.exp(-period / config.decay) + config.growth * jnp.max(jnp.abs(moved))
    return jnp.minimum(grown, amplitude * jnp.exp(-jnp.maximum(waited, 0.0) / config.lifetime))


def dither(config: DitherConfig, swing: jax.Array, base_lengths: jax.Array, waited: jax.Array) -> jax.Array:
    """What the dither adds to the cables (num_cables,) [m] a time [s] after the ramp's end; first against the way they came."""
    reversals = jnp.floor(jnp.maximum(waited, 0.0) / config.half_period + 1e-6)
    signed = jnp.where(reversals % 2 == 0, -swing, swing)
    return jnp.where(waited >= 0.0, signed, 0.0) * jnp.sign(base_lengths)


def action_size(config: ResidualConfig, robot: Robot) -> int:
    """How many numbers an action has."""
    return 6 if config.space == "tip" else robot.num_cables


def move_residual(config: ResidualConfig, residual: jax.Array, action: jax.Array, period: float) -> jax.Array:
    """Residual (action_size,) [m] after one control period [s]: towards `bound` times the action, with `lag`, at most at `rate`."""
    largest, share = config.rate * period, 1.0 - math.exp(-period / config.lag) if config.lag > 0.0 else 1.0
    wanted = config.bound * jnp.clip(action, -1.0, 1.0)
    return residual + jnp.clip(share * (wanted - residual), -largest, largest)


def residual_lengths(config: ResidualConfig, residual: jax.Array, correction: jax.Array) -> jax.Array:
    """Cable lengths (num_cables,) [m] of a residual; `correction` (num_cables, 6) is `tip_correction.damped_pseudo_inverse`."""
    return correction @ residual if config.space == "tip" else residual


def action_of(config: ResidualConfig, error: jax.Array, correction: jax.Array) -> jax.Array:
    """Action (action_size,) whose residual makes up for an error of the tip, `tip_correction.tip_error` (6,) [m]."""
    return (error if config.space == "tip" else correction @ error) / config.bound


def limit_lengths(robot: Robot, desired: jax.Array) -> jax.Array:
    """Cable lengths (num_cables,) [m] within the strokes that the arm's joint limits leave."""
    strokes = cable_strokes(robot)
    return jnp.clip(desired, -strokes, strokes)


def limit_speed(robot: Robot, command: jax.Array, desired: jax.Array, period: float) -> jax.Array:
    """Motor command (num_cables,) [m] one period later: towards `desired`, at most at motor speed."""
    largest = robot.motor_speed * period
    return command + jnp.clip(desired - command, -largest, largest)
