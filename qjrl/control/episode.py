"""One episode of one arm as pure functions: begin, restart, command, observe. The environment maps them over many.

begin ─> (physics put at home) ─> restart ─> [ command ─> (physics steps) ─> observe ] ...
"""

import dataclasses
import math
from typing import Annotated

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.config import Range
from qjrl.control import motors, tip_correction
from qjrl.control.observations import (
    ACTION_HISTORY,
    ControlState,
    TrueState,
    actor_observation,
    critic_observation,
    held_rotation_vectors,
)
from qjrl.control.randomisation import RandomisationConfig, draw_parameters
from qjrl.control.rewards import RewardConfig, reward
from qjrl.control.sensors import MEMORY_SIZE, SETTLING, read_encoders, remember
from qjrl.geometry.pose import orientation_error, position_error
from qjrl.learning.ppo.environment import ACTOR_KEY, CRITIC_KEY
from qjrl.robot import configuration_from_joint_positions, strand_commands
from qjrl.robot.verbs import Robot


@dataclasses.dataclass(frozen=True)
class EnvironmentConfig:
    """One episode and one step."""

    episode_steps: Annotated[int, Range(10, 100_000)] = 200
    """Control steps of an episode (paper 000, section 5.4.2: 4 s)."""
    control_period: Annotated[float, Range(above=0.0, high=1.0)] = 0.02
    """[s]; 50 Hz (paper 000, section 4)."""
    latest_arrival: Annotated[float, Range(above=0.0)] = 3.0
    """Targets whose base ramp ends later are left out and counted [s]."""
    scored_time: Annotated[float, Range(above=0.0)] = 0.5
    """Errors are judged over this long at the end of an episode [s]."""
    dither: motors.DitherConfig = motors.DitherConfig()
    integral: tip_correction.IntegralConfig = tip_correction.IntegralConfig()
    residual: motors.ResidualConfig = motors.ResidualConfig()
    reward: RewardConfig = RewardConfig()
    randomisation: RandomisationConfig = RandomisationConfig()

    def __post_init__(self):
        duration = self.episode_steps * self.control_period
        if self.latest_arrival + self.scored_time > duration:
            raise ValueError(
                f"latest_arrival: got {self.latest_arrival}, allowed: at most {duration - self.scored_time:g} "
                f"(an episode of {duration:g} s less scored_time)"
            )

    @property
    def scored_steps(self) -> int:
        """Control steps over which the error is judged."""
        return math.ceil(self.scored_time / self.control_period)


@struct.dataclass
class Bank:
    """Targets and base commands that episodes draw from."""

    target: jax.Array
    """(rows, 9)."""
    base_lengths: jax.Array
    """(rows, num_cables) [m]."""


@struct.dataclass
class Begun:
    """A new episode, before the physics is put where it begins."""

    state: ControlState
    parameters: dict[str, jax.Array]


@struct.dataclass
class StepOutcome:
    """One control step of one arm."""

    state: ControlState
    observation: dict[str, jax.Array]
    reward: jax.Array
    is_over: jax.Array
    metrics: dict[str, jax.Array]


def begin(
    config: EnvironmentConfig, robot: Robot, bank: Bank, key: jax.Array, row: jax.Array, is_first: jax.Array
) -> Begun:
    """Target, base command and physical parameters of a new episode; `row` -1 draws one, a first episode is cut short."""
    key_row, key_parameters, key_length, key_next = jax.random.split(key, 4)
    row = jnp.where(row < 0, jax.random.randint(key_row, (), 0, len(bank.target)), row)
    cut = jax.random.randint(key_length, (), 1, config.episode_steps + 1)
    zeros = jnp.zeros((robot.num_cables,), bank.base_lengths.dtype)
    residual = jnp.zeros((motors.action_size(config.residual, robot),), zeros.dtype)
    readings = jnp.zeros((robot.num_segments, 2), bank.base_lengths.dtype)
    state = ControlState(
        target=bank.target[row],
        base_lengths=bank.base_lengths[row],
        command=zeros,
        course=zeros,
        swing=zeros[0],
        correction=tip_correction.correction_matrix(robot, bank.base_lengths[row]),
        integral=zeros,
        residual=residual,
        actions=jnp.zeros((ACTION_HISTORY, len(residual)), zeros.dtype),
        reading=readings,
        memory=jnp.zeros((MEMORY_SIZE, *readings.shape), zeros.dtype),
        step=jnp.zeros((), jnp.int32),
        initial_errors=jnp.zeros(2, zeros.dtype),
        episode_steps=jnp.where(is_first, cut, config.episode_steps).astype(jnp.int32),
        key=key_next,
    )
    return Begun(state, draw_parameters(config.randomisation, key_parameters))


def restart(config: EnvironmentConfig, robot: Robot, state: ControlState, truth: TrueState):
    """First reading and first observation of an episode, from the physics at rest at home."""
    reading, key_next = _read(config, robot, state, truth)
    errors = _errors(truth, state)
    memory = jnp.broadcast_to(reading - held_rotation_vectors(robot, state.command), state.memory.shape)
    state = dataclasses.replace(
        state, reading=reading, memory=memory, initial_errors=errors.astype(state.residual.dtype), key=key_next
    )
    return state, _observation(config, robot, state, truth, errors)


def command(config: EnvironmentConfig, robot: Robot, state: ControlState, action: jax.Array):
    """The next control state's commands and the strands' rest lengths: all that is added summed before one limiter."""
    period = config.control_period
    residual = motors.move_residual(config.residual, state.residual, action, period)
    time = (state.step + 1) * period
    added = state.integral + motors.residual_lengths(config.residual, residual, state.correction)
    course = motors.ramped_base(robot, state.base_lengths, time) + added
    swing = motors.next_swing(config.dither, state.swing, course - state.course, period)
    waited = time - motors.ramp_time(robot, state.base_lengths)
    desired = course + motors.dither(config.dither, swing, state.base_lengths, waited)
    lengths = motors.limit_speed(robot, state.command, desired, period)
    actions = jnp.concatenate([action[None], state.actions[:-1]])
    planned = dataclasses.replace(
        state, residual=residual, course=course, swing=swing, command=lengths, actions=actions
    )
    return planned, strand_commands(robot, lengths)


def observe(config: EnvironmentConfig, robot: Robot, state: ControlState, truth: TrueState) -> StepOutcome:
    """Sensors, feedback, reward and end of episode after the physics has moved."""
    reading, key_next = _read(config, robot, state, truth)
    state = dataclasses.replace(state, step=state.step + 1, reading=reading, key=key_next)
    state = _remember(config, robot, state)
    has_arrived = _ramp(config, robot, state) >= 1.0
    errors = _errors(truth, state)
    earned = reward(config.reward, errors[0], errors[1], state.actions[0], has_arrived)
    metrics = {
        "position_error": errors[0],
        "orientation_error": errors[1],
        "residual": jnp.max(jnp.abs(state.residual)),
    }
    observation = _observation(config, robot, state, truth, errors)
    return StepOutcome(state, observation, earned, state.step >= state.episode_steps, metrics)


def _read(config: EnvironmentConfig, robot: Robot, state: ControlState, truth: TrueState):
    """The encoders' reading now, and the key of the next one."""
    key_noise, key_next = jax.random.split(state.key)
    bends = configuration_from_joint_positions(robot, truth.joint_positions)
    reading = read_encoders(robot, bends, config.randomisation.encoder_noise_deg, key_noise)
    return reading.astype(state.reading.dtype), key_next


def _remember(config: EnvironmentConfig, robot: Robot, state: ControlState) -> ControlState:
    """The memory and the integral after a reading; feedback acts once the base command is ramped in and the dither over."""
    deviation = state.reading - held_rotation_vectors(robot, state.command)
    memory = remember(state.memory, deviation, _waited(config, robot, state), config.control_period).astype(
        state.memory.dtype
    )
    difference = tip_correction.weighted_difference(tip_correction.sensed_pose(robot, state.reading), state.target)
    moved = tip_correction.integrate(
        config.integral, state.integral, state.correction, difference, config.control_period
    )
    begins = SETTLING if config.dither.amplitude > 0.0 else 0.0
    acts = (_ramp(config, robot, state) >= 1.0) & (_waited(config, robot, state) >= begins)
    integral = jnp.where(acts, moved, state.integral).astype(state.integral.dtype)
    return dataclasses.replace(state, memory=memory, integral=integral)


def _observation(
    config: EnvironmentConfig, robot: Robot, state: ControlState, truth: TrueState, errors: jax.Array
) -> dict[str, jax.Array]:
    offset = motors.residual_lengths(config.residual, state.residual, state.correction)
    actor = actor_observation(robot, state, offset, _ramp(config, robot, state), _waited(config, robot, state))
    advice = _advice(config, robot, state, truth)
    return {ACTOR_KEY: actor, CRITIC_KEY: critic_observation(actor, state, truth, errors, advice)}


def _advice(config: EnvironmentConfig, robot: Robot, state: ControlState, truth: TrueState) -> jax.Array:
    """The action whose offset would take the tip to its target, as only the simulation can know; none before it has settled."""
    lacking = tip_correction.weighted_difference(truth.pose, state.target)
    advised = motors.advised_action(config.residual, state.residual, lacking, state.correction)
    return jnp.where(_waited(config, robot, state) >= SETTLING, advised, 0.0)


def _ramp(config: EnvironmentConfig, robot: Robot, state: ControlState) -> jax.Array:
    """How much of the base command is ramped in, 0 to 1."""
    duration = jnp.maximum(motors.ramp_time(robot, state.base_lengths), config.control_period)
    return jnp.minimum(state.step * config.control_period / duration, 1.0)


def _waited(config: EnvironmentConfig, robot: Robot, state: ControlState) -> jax.Array:
    """Time [s] since the base command is ramped in."""
    return jnp.maximum(state.step * config.control_period - motors.ramp_time(robot, state.base_lengths), 0.0)


def _errors(truth: TrueState, state: ControlState) -> jax.Array:
    return jnp.stack([position_error(truth.pose, state.target), orientation_error(truth.pose, state.target)])
