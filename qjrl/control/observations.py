"""What actor and critic see, as flat float32 vectors."""

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.control.sensors import exact_reading
from qjrl.control.tip_correction import sensed_pose, tip_error
from qjrl.robot.plant import PlantState
from qjrl.robot.verbs import Robot, configuration_from_cables

# Actions the actor remembers (paper 000, section 4).
ACTION_HISTORY = 4


@struct.dataclass
class Gains:
    """What tells the base controllers apart. Numbers, not constants: one compiled program serves all bases."""

    integral: jax.Array
    """Of integral feedback [1/s]."""
    dither: jax.Array
    """Largest swing of a cable [m]."""
    estimate: jax.Array
    """1: feedback from the estimate of the arm acts; 0: it does not."""


@struct.dataclass
class ControlState:
    """What the controller of one arm knows and carries from step to step."""

    gains: Gains

    target: jax.Array
    """(9,) pose [m, -]."""
    base_lengths: jax.Array
    """(num_cables,) the base controller's answer [m]."""
    command: jax.Array
    """(num_cables,) what the motors hold now [m]."""
    trend: jax.Array
    """(num_cables,) what feedback and policy add to the base command, smoothed [m]."""
    swing: jax.Array
    """What the dither swings by [m]."""
    correction: jax.Array
    """(num_cables, 6) cables for each metre that the tip lacks, around the base command."""
    expected: jax.Array
    """(...) deviation from the command with which the arm is believed to rest before it is read [rad]."""
    covariance: jax.Array
    """(coordinates, coordinates) of that, in standard deviations of one reading."""
    integral: jax.Array
    """(num_cables,) what integral feedback adds [m]."""
    residual: jax.Array
    """(action size,) what the policy adds, of the tip or of the cables [m]."""
    actions: jax.Array
    """(ACTION_HISTORY, action size), newest first."""
    reading: jax.Array
    """(...) newest encoder estimate, of the configuration's shape [rad]."""
    memory: jax.Array
    """(MEMORY_SIZE, ...) means of the readings' deviation from the command [rad]."""
    estimated: jax.Array
    """(...) estimate of how far from where a perfect arm would be this one rests [rad]."""
    tip_error: jax.Array
    """(6,) what the tip lacks of its target by that estimate, without residual and dither [m]."""
    step: jax.Array
    """Control steps since the start."""


def actor_observation(
    robot: Robot,
    state: ControlState,
    offset: jax.Array,
    ramp: jax.Array,
    waited: jax.Array,
) -> jax.Array:
    """Only what the real robot has: sensor memory, last actions, motor command, target, base command, residual, clock.

    Beside the readings' deviations from the command stands what the tip would lack of its target without the residual,
    according to each of them: the same numbers, but with the millimetres that matter not lost among the radians, and
    the residual to choose, not a change of it, so that an error of the actor does not add up. It is zero until the base
    command is ramped in: on the way to the target it would be far larger than the errors that matter at the end.

    Args:
        offset: (num_cables,) the residual's part of the command [m].
        ramp: how much of the base command is ramped in, 0 to 1.
        waited: time [s] since then.
    """
    held = held_reading(robot, state.command)
    deviations = jnp.concatenate([(state.reading - held)[None], state.memory])
    without = held_reading(robot, state.command - offset)
    read = jax.vmap(lambda one: tip_error(sensed_pose(robot, without + one), state.target))(deviations)
    parts = (
        held_reading(robot, state.base_lengths),
        deviations,
        state.estimated,
        jnp.where(ramp >= 1.0, read, 0.0),
        state.tip_error,
        state.actions,
        state.command,
        state.target,
        state.base_lengths,
        state.integral,
        state.residual,
        state.swing[None],
        ramp[None],
        waited[None],
    )
    return jnp.concatenate([part.reshape(-1) for part in parts]).astype(jnp.float32)


def held_reading(robot: Robot, command: jax.Array) -> jax.Array:
    """What perfect encoders would read where a motor command (num_cables,) [m] holds a perfect robot."""
    return exact_reading(robot, configuration_from_cables(robot, command))


def critic_observation(
    actor: jax.Array,
    target: jax.Array,
    plant: PlantState,
    errors: jax.Array,
    initial_errors: jax.Array,
    expert_action: jax.Array,
) -> jax.Array:
    """The actor's, then what the paper adds: tendon lengths and velocities, joint positions, true pose, errors; and the
    expert's action.

    Joint velocities are left out, as in the paper: they jitter in MJX.

    Args:
        target: (9,) pose.
        errors: (2,) position [m] and orientation [rad] error now; `initial_errors` those at the start.
    """
    parts = (
        actor,
        plant.strand_lengths,
        plant.strand_velocities,
        plant.joint_positions,
        plant.pose,
        plant.pose - target,
        errors,
        initial_errors,
        expert_action,
    )
    return jnp.concatenate([part.reshape(-1) for part in parts]).astype(jnp.float32)
