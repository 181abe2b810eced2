"""One episode of one simulated arm as pure functions: begin, restart, command, observe. `environment` maps them over many.

begin ─> (physics put at home) ─> restart ─> [ command ─> (physics steps) ─> observe ] ...

What the robot computes is `controller`'s; here is what only a simulation knows: the plant, errors, reward, expert, the end.
"""

import dataclasses
import math
from functools import partial
from typing import Annotated

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.config import Range, configuration
from qjrl.control import controller, motors, termination, tip_correction
from qjrl.control.arm_estimate import EstimateConfig, priors
from qjrl.control.controller import ControllerConfig, Task
from qjrl.control.faults import Faults, draw_faults, transmit
from qjrl.control.observations import ControlState, critic_observation
from qjrl.control.randomisation import RandomisationConfig, draw_parameters
from qjrl.control.rewards import RewardConfig, reward
from qjrl.control.sensors import SETTLING, read_encoders
from qjrl.control.termination import TerminationConfig
from qjrl.geometry.pose import orientation_error, position_error
from qjrl.learning.ppo.environment import ACTOR_KEY, CRITIC_KEY, EXPERT_KEY
from qjrl.robot import configuration_from_joint_positions, strand_commands
from qjrl.robot.plant import PhysicalParameters, PlantState
from qjrl.robot.verbs import Robot


@configuration
class EnvironmentConfig:
    """One episode and one step."""

    episode_steps: Annotated[int, Range(10, 100_000)] = 200
    """Control steps of an episode (paper 000, section 5.4.2: 4 s)."""
    control_period: Annotated[float, Range(above=0.0, high=1.0)] = 0.02
    """[s]; 50 Hz (paper 000, section 4)."""
    latest_arrival: Annotated[float, Range(above=0.0)] = 3.0
    """Targets whose base ramp ends later are left out and counted [s]; ours."""
    scored_time: Annotated[float, Range(above=0.0)] = 0.5
    """Errors are evaluated over this long at the end of an episode [s]; ours."""
    remembers: bool = True
    """Whether the actor sees means of the encoders' readings; without, the newest reading stands for all of them."""
    estimate: EstimateConfig = EstimateConfig()
    dither: motors.DitherConfig = motors.DitherConfig()
    integral: tip_correction.IntegralConfig = tip_correction.IntegralConfig()
    residual: motors.ResidualConfig = motors.ResidualConfig()
    reward: RewardConfig = RewardConfig()
    termination: TerminationConfig = TerminationConfig()
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
        """Control steps over which the error is evaluated."""
        return math.ceil(self.scored_time / self.control_period)

    @property
    def controller(self) -> ControllerConfig:
        """What the robot needs of it."""
        parts = self.estimate, self.dither, self.integral, self.residual
        return ControllerConfig(self.control_period, self.remembers, *parts)


@struct.dataclass
class Bank:
    """Targets and base commands that episodes draw from."""

    target: jax.Array
    """(rows, 9)."""
    base_lengths: jax.Array
    """(rows, num_cables) [m]."""


def tasks_of(config: EnvironmentConfig, robot: Robot, bank: Bank) -> Task:
    """The tasks of a bank, a row each: all that a reset needs and that follows from a row alone."""
    believed = priors(
        dataclasses.replace(config.estimate, acts=True), robot, bank.base_lengths
    )  # the same whether it acts
    gains = controller.gains_of(config.controller, bank.base_lengths.dtype)
    of_rows = jax.tree.map(lambda number: jnp.broadcast_to(number, len(bank.target)), gains)
    return Task(bank.target, bank.base_lengths, _corrections(robot, bank.base_lengths), believed, of_rows)


@jax.jit
def _corrections(robot: Robot, base_lengths: jax.Array) -> jax.Array:
    return jax.vmap(partial(tip_correction.damped_pseudo_inverse, robot))(base_lengths)


@struct.dataclass
class EpisodeState:
    """What one arm carries from step to step."""

    control: ControlState
    """The robot's own."""
    faults: Faults
    """Of which the robot knows nothing."""
    overloaded: jax.Array
    """Time for which a motor or a strand has been at its limit [s]."""
    initial_errors: jax.Array
    """(2,) position [m] and orientation [rad] error at the start."""
    needed: jax.Array
    """(action size,) the action that would take the tip to its target, smoothed since the base command was ramped in."""
    episode_steps: jax.Array
    """Step at which this episode ends."""
    key: jax.Array


@struct.dataclass
class Begun:
    """A new episode, before the physics is put where it begins."""

    state: EpisodeState
    parameters: PhysicalParameters


@struct.dataclass
class StepOutcome:
    """One control step of one arm."""

    state: EpisodeState
    observation: dict[str, jax.Array]
    reward: jax.Array
    is_over: jax.Array
    """By the time limit."""
    is_lost: jax.Array
    metrics: dict[str, jax.Array]


def begin(
    config: EnvironmentConfig, robot: Robot, tasks: Task, key: jax.Array, row: jax.Array, is_cut: jax.Array
) -> Begun:
    """Task and physical parameters of a new episode; `row` -1 draws one; an episode that is cut ends early, at random."""
    key_row, key_parameters, key_length, key_next, key_faults = jax.random.split(key, 5)
    row = jnp.where(row < 0, jax.random.randint(key_row, (), 0, len(tasks.target)), row)
    cut = jax.random.randint(key_length, (), 1, config.episode_steps + 1)
    control = controller.begin(config.controller, robot, jax.tree.map(lambda values: values[row], tasks))
    dtype = control.command.dtype
    state = EpisodeState(
        control=control,
        faults=draw_faults(config.randomisation, robot, key_faults, control.command),
        overloaded=jnp.zeros((), dtype),
        initial_errors=jnp.zeros(2, dtype),
        needed=jnp.zeros_like(control.residual),
        episode_steps=jnp.where(is_cut, cut, config.episode_steps).astype(jnp.int32),
        key=key_next,
    )
    return Begun(state, draw_parameters(config.randomisation, robot, key_parameters))


def restart(config: EnvironmentConfig, robot: Robot, state: EpisodeState, plant: PlantState):
    """First reading and first observation of an episode, from the physics at rest at home."""
    reading, key_next = _read(config, robot, state, plant)
    control = controller.start(config.controller, robot, state.control, reading)
    errors = _errors(plant, control)
    state = dataclasses.replace(
        state, control=control, initial_errors=errors.astype(state.initial_errors.dtype), key=key_next
    )
    return state, _observation(config, robot, state, plant, errors)


def command(config: EnvironmentConfig, robot: Robot, state: EpisodeState, action: jax.Array):
    """The next state's commands, and the strands' rest lengths: what the faults leave of them."""
    planned = controller.plan(config.controller, robot, state.control, action)
    faults = transmit(state.faults, planned.command)
    return dataclasses.replace(state, control=planned, faults=faults), strand_commands(robot, faults.held)


def observe(config: EnvironmentConfig, robot: Robot, state: EpisodeState, plant: PlantState) -> StepOutcome:
    """Sensors, feedback, reward and end of episode after the physics has moved."""
    reading, key_next = _read(config, robot, state, plant)
    control = controller.sense(config.controller, robot, state.control, reading)
    overloaded = termination.overloaded_for(robot, state.overloaded, plant, config.control_period)
    needed = _needed(config, robot, state.needed, control, plant)
    state = dataclasses.replace(state, control=control, overloaded=overloaded, needed=needed, key=key_next)
    has_arrived = controller.ramped_in(config.controller, robot, control) >= 1.0
    errors = _errors(plant, control)
    is_lost = termination.is_lost(config.termination, robot, plant, overloaded)
    earned = reward(config.reward, errors[0], errors[1], control.actions[0], has_arrived)
    earned = earned - jnp.where(is_lost, config.termination.cost, 0.0)
    metrics: dict[str, jax.Array] = dict(
        zip(METRICS, (errors[0], errors[1], jnp.max(jnp.abs(control.residual))), strict=True)
    )
    observation = _observation(config, robot, state, plant, errors)
    return StepOutcome(state, observation, earned, control.step >= state.episode_steps, is_lost, metrics)


def _read(config: EnvironmentConfig, robot: Robot, state: EpisodeState, plant: PlantState):
    """The encoders' reading now, and the key of the next one."""
    key_noise, key_next = jax.random.split(state.key)
    bends = configuration_from_joint_positions(robot, plant.joint_positions)
    noise_deg, working = config.randomisation.encoder_noise_deg, state.faults.working_encoders
    reading = read_encoders(robot, bends, noise_deg, key_noise, working)
    return reading.astype(state.control.reading.dtype), key_next


def _observation(
    config: EnvironmentConfig, robot: Robot, state: EpisodeState, plant: PlantState, errors: jax.Array
) -> dict[str, jax.Array]:
    actor = controller.observation(config.controller, robot, state.control)
    expert = _expert_action(config, robot, state.control, state.needed)
    critic = critic_observation(actor, state.control.target, plant, errors, state.initial_errors, expert)
    return {ACTOR_KEY: actor, CRITIC_KEY: critic, EXPERT_KEY: expert.astype(jnp.float32)}


def _needed(config: EnvironmentConfig, robot: Robot, before: jax.Array, control: ControlState, plant: PlantState):
    """The action that takes the tip to its target, as only the simulation can know, smoothed: the dither's swings are
    not to be answered."""
    error = tip_correction.tip_error(plant.pose, control.target)
    now = control.residual / config.residual.bound + motors.action_of(config.residual, error, control.correction)
    share = 1.0 - math.exp(-config.control_period / _SMOOTHING)
    smoothed = before + share * (now - before)
    return jnp.where(controller.waited(config.controller, robot, control) > 0.0, smoothed, now).astype(before.dtype)


def _expert_action(config: EnvironmentConfig, robot: Robot, control: ControlState, needed: jax.Array) -> jax.Array:
    """What the policy should add to the controller's own action; nothing before the arm has settled."""
    own = controller.own_action(config.controller, control)
    advised = jnp.clip(jnp.clip(needed, -1.0, 1.0) - own, -1.0, 1.0)
    return jnp.where(controller.waited(config.controller, robot, control) >= SETTLING, advised, 0.0)


def _errors(plant: PlantState, control: ControlState) -> jax.Array:
    return jnp.stack([position_error(plant.pose, control.target), orientation_error(plant.pose, control.target)])


METRICS: tuple[str, ...] = ("position_error", "orientation_error", "residual")
"""Names of `StepOutcome.metrics`."""
# Time constant [s]: five control periods, in which swings that turn at every one leave a tenth of themselves.
_SMOOTHING = 0.1
