"""What the real robot computes: from target, base command and encoder readings to motor commands.

begin ─> start ─> [ observation ─> (policy) ─> plan ─> (motors, encoders) ─> sense ] ...

Pure functions of one arm. The environment maps them over many simulated ones, a deployed controller runs them for one:
there `prepare` is the first two, `tick` the rest, turned so that it begins with a reading and ends with a command.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.control import arm_estimate, motors, tip_correction
from qjrl.control.observations import ACTION_HISTORY, ControlState, Gains, actor_observation, held_reading
from qjrl.control.sensors import MEMORY_SIZE, SETTLING, readings_at_the_end, remember
from qjrl.robot.kinds import configuration_shape
from qjrl.robot.verbs import Robot


@dataclasses.dataclass(frozen=True)
class ControllerConfig:
    """The part of an environment's configuration that a controller needs."""

    control_period: float
    """[s]."""
    remembers: bool
    """Whether the policy sees means of the readings, or the newest one in their place."""
    estimate: arm_estimate.EstimateConfig
    dither: motors.DitherConfig
    integral: tip_correction.IntegralConfig
    residual: motors.ResidualConfig


def prepare(
    config: ControllerConfig, robot: Robot, target: jax.Array, base_lengths: jax.Array, reading: jax.Array
) -> ControlState:
    """The state before the first `tick`, which gets the same reading, of the configuration's shape [rad], again: its clock stands at -1.

    A memory that holds this reading alone is not changed by it, and no feedback acts while the base command is ramped in.
    """
    state = start(config, robot, begin(config, robot, task_of(config, robot, target, base_lengths)), reading)
    return dataclasses.replace(state, step=state.step - 1)


def tick(
    config: ControllerConfig,
    robot: Robot,
    act: Callable[[jax.Array], jax.Array],
    state: ControlState,
    reading: jax.Array,
) -> ControlState:
    """One control period of a robot: from a reading, of the configuration's shape [rad], to the command that the motors shall hold now.

    Args:
        act: what the policy does on an observation.
    """
    state = sense(config, robot, state, reading)
    action = act(observation(config, robot, state)).astype(state.residual.dtype)
    return plan(config, robot, state, action)


@struct.dataclass
class Task:
    """A target, the base controller's answer to it, and what follows from them alone."""

    target: jax.Array
    """(9,) pose [m, -]."""
    base_lengths: jax.Array
    """(num_cables,) [m]."""
    correction: jax.Array
    """(num_cables, 6), see `tip_correction.damped_pseudo_inverse`."""
    prior: arm_estimate.Prior
    gains: Gains


def task_of(config: ControllerConfig, robot: Robot, target: jax.Array, base_lengths: jax.Array) -> Task:
    """The task of a target (9,) and the base controller's answer to it (num_cables,) [m]."""
    correction = tip_correction.damped_pseudo_inverse(robot, base_lengths)
    believed = arm_estimate.prior(config.estimate, robot, base_lengths)
    return Task(target, base_lengths, correction, believed, gains_of(config, base_lengths.dtype))


def gains_of(config: ControllerConfig, dtype: Any) -> Gains:
    """The numbers in which the bases differ."""
    numbers = config.integral.gain, config.dither.amplitude, config.estimate.acts
    return Gains(*(jnp.asarray(number, dtype) for number in numbers))


def begin(config: ControllerConfig, robot: Robot, task: Task) -> ControlState:
    """The state at the begin of a task; the arm is at home."""
    zeros = jnp.zeros((robot.num_cables,), task.base_lengths.dtype)
    residual = jnp.zeros((motors.action_size(config.residual, robot),), zeros.dtype)
    readings = jnp.zeros(configuration_shape(robot), zeros.dtype)
    return ControlState(
        gains=task.gains,
        target=task.target,
        base_lengths=task.base_lengths,
        command=zeros,
        trend=zeros,
        swing=task.gains.dither,  # friction holds an arm that hardly moves, too
        correction=task.correction,
        expected=task.prior.expected,
        covariance=task.prior.covariance,
        integral=zeros,
        residual=residual,
        actions=jnp.zeros((ACTION_HISTORY, len(residual)), zeros.dtype),
        reading=readings,
        memory=jnp.zeros((MEMORY_SIZE, *readings.shape), zeros.dtype),
        estimated=readings,
        tip_error=jnp.zeros((6,), zeros.dtype),
        step=jnp.zeros((), jnp.int32),
    )


def start(config: ControllerConfig, robot: Robot, state: ControlState, reading: jax.Array) -> ControlState:
    """The first reading, of the configuration's shape [rad], fills the memory."""
    memory = jnp.broadcast_to(reading - held_reading(robot, state.command), state.memory.shape)
    return _estimated(config, robot, dataclasses.replace(state, reading=reading, memory=memory))


def observation(config: ControllerConfig, robot: Robot, state: ControlState) -> jax.Array:
    """What the policy sees."""
    offset = motors.residual_lengths(config.residual, state.residual, state.correction)
    return actor_observation(robot, state, offset, ramped_in(config, robot, state), waited(config, robot, state))


def own_action(config: ControllerConfig, state: ControlState) -> jax.Array:
    """What the controller does without a policy (action size,): what the tip lacks by the estimate, if that shall act."""
    wanted = motors.action_of(config.residual, state.tip_error, state.correction)
    return (state.gains.estimate * wanted).astype(state.residual.dtype)


def _estimated(config: ControllerConfig, robot: Robot, state: ControlState) -> ControlState:
    """With the estimate of where this arm rests, and of its tip's error without residual and dither: nothing before it has
    settled."""
    since = waited(config, robot, state)
    count = readings_at_the_end(since, config.control_period) if config.remembers else jnp.ones_like(since)
    believed = arm_estimate.Prior(state.expected, state.covariance)
    guess = arm_estimate.estimate(config.estimate, robot, believed, state.memory[-1], count)
    held = held_reading(robot, state.base_lengths + state.integral)
    error = tip_correction.tip_error(tip_correction.sensed_pose(robot, held + guess), state.target)
    has_settled = (ramped_in(config, robot, state) >= 1.0) & (since >= SETTLING)
    error = jnp.where(has_settled, error, 0.0).astype(state.tip_error.dtype)
    return dataclasses.replace(state, estimated=guess.astype(state.estimated.dtype), tip_error=error)


def plan(config: ControllerConfig, robot: Robot, state: ControlState, action: jax.Array) -> ControlState:
    """The next motor command from an action (action size,): all that is added summed before the limits."""
    period = config.control_period
    whole = own_action(config, state) + action
    residual = motors.move_residual(config.residual, state.residual, whole, period)
    time = (state.step + 1) * period
    added = state.integral + motors.residual_lengths(config.residual, residual, state.correction)
    ramped = motors.ramped_base(robot, state.base_lengths, time)
    trend = motors.smoothed(config.dither, state.trend, added, period)
    moved = ramped - motors.ramped_base(robot, state.base_lengths, time - period) + trend - state.trend
    after = time - motors.ramp_time(robot, state.base_lengths)
    swing = motors.next_swing(config.dither, state.gains.dither, state.swing, moved, after, period)
    desired = ramped + added + motors.dither(config.dither, swing, state.base_lengths, after)
    lengths = motors.limit_speed(robot, state.command, motors.limit_lengths(robot, desired), period)
    actions = jnp.concatenate([action[None], state.actions[:-1]])
    return dataclasses.replace(state, residual=residual, trend=trend, swing=swing, command=lengths, actions=actions)


def sense(config: ControllerConfig, robot: Robot, state: ControlState, reading: jax.Array) -> ControlState:
    """A reading, of the configuration's shape [rad], one control period later: memory, integral and estimate.

    Feedback acts once the base command is ramped in and the first swings of the dither are over.
    """
    state = dataclasses.replace(state, step=state.step + 1, reading=reading)
    deviation = state.reading - held_reading(robot, state.command)
    memory = remember(state.memory, deviation, waited(config, robot, state), config.control_period)
    if not config.remembers:
        memory = jnp.broadcast_to(deviation, memory.shape)
    difference = tip_correction.tip_error(tip_correction.sensed_pose(robot, state.reading), state.target)
    moved = tip_correction.integrate(
        config.integral, state.gains.integral, state.integral, state.correction, difference, config.control_period
    )
    begins = jnp.where(state.gains.dither > 0.0, config.dither.decay, 0.0)
    acts = (ramped_in(config, robot, state) >= 1.0) & (waited(config, robot, state) >= begins)
    integral = jnp.where(acts, moved, state.integral).astype(state.integral.dtype)
    state = dataclasses.replace(state, memory=memory.astype(state.memory.dtype), integral=integral)
    return _estimated(config, robot, state)


def ramped_in(config: ControllerConfig, robot: Robot, state: ControlState) -> jax.Array:
    """How much of the base command is ramped in, 0 to 1."""
    duration = jnp.maximum(motors.ramp_time(robot, state.base_lengths), config.control_period)
    return jnp.minimum(state.step * config.control_period / duration, 1.0)


def waited(config: ControllerConfig, robot: Robot, state: ControlState) -> jax.Array:
    """Time [s] since the base command is ramped in."""
    return jnp.maximum(state.step * config.control_period - motors.ramp_time(robot, state.base_lengths), 0.0)
