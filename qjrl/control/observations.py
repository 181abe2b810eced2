"""What actor and critic see, as flat float32 vectors."""

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.control.sensors import bends_of_rotation_vectors, rotation_vectors
from qjrl.robot import bends_from_cables, forward_kinematics
from qjrl.robot.verbs import Robot

# Actions the actor remembers (paper 000, section 4).
ACTION_HISTORY = 4


@struct.dataclass
class ControlState:
    """What the controller of one arm knows and carries from step to step."""

    target: jax.Array
    """(9,) pose [m, -]."""
    base_lengths: jax.Array
    """(num_cables,) the base controller's answer [m]."""
    command: jax.Array
    """(num_cables,) what the motors hold now [m]."""
    residual: jax.Array
    """(num_cables,) [m]."""
    actions: jax.Array
    """(ACTION_HISTORY, num_cables), newest first."""
    reading: jax.Array
    """(segments, 2) newest encoder estimate [rad]."""
    memory: jax.Array
    """(constants, segments, 2) exponential means of the readings [rad]."""
    step: jax.Array
    """Control steps since the start of the episode."""
    initial_errors: jax.Array
    """(2,) position [m] and orientation [rad] error at the start."""
    episode_steps: jax.Array
    """Step at which this episode ends."""
    key: jax.Array


@struct.dataclass
class TrueState:
    """What only the simulation knows of one arm."""

    joint_positions: jax.Array
    strand_lengths: jax.Array
    strand_velocities: jax.Array
    pose: jax.Array


def actor_observation(robot: Robot, state: ControlState, ramp: jax.Array) -> jax.Array:
    """Only what the real robot has: sensor memory, last actions, motor command, target, base command, residual.

    Readings are given as deviations from the bends at which the motor command would hold a perfect arm, and as the
    tip's deviation from the target by the closed-form kinematics of the slowest mean: the same numbers, but with the
    millimetres that matter not lost among the radians.
    """
    held = rotation_vectors(bends_from_cables(robot, state.command))
    estimated_pose = forward_kinematics(robot, bends_of_rotation_vectors(state.memory[-1]))
    parts = (
        rotation_vectors(bends_from_cables(robot, state.base_lengths)),
        state.reading - held,
        state.memory - held,
        estimated_pose - state.target,
        state.actions,
        state.command,
        state.target,
        state.base_lengths,
        state.residual,
        ramp[None],
    )
    return jnp.concatenate([part.reshape(-1) for part in parts]).astype(jnp.float32)


def critic_observation(actor: jax.Array, state: ControlState, truth: TrueState, errors: jax.Array) -> jax.Array:
    """The actor's, then what the paper adds: tendon lengths and velocities, joint positions, true pose, errors.

    Joint velocities are left out, as in the paper: they jitter in MJX.
    """
    parts = (
        actor,
        truth.strand_lengths,
        truth.strand_velocities,
        truth.joint_positions,
        truth.pose,
        truth.pose - state.target,
        errors,
        state.initial_errors,
    )
    return jnp.concatenate([part.reshape(-1) for part in parts]).astype(jnp.float32)
