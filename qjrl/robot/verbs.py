"""The verbs every kind of robot may offer, dispatched on `robot.kind`."""

from typing import Any

import jax
import jax.numpy as jnp

from qjrl.robot.quaternion_arm import cables, coordinates, kinematics, mjcf, statics
from qjrl.robot.quaternion_arm.description import QuaternionArm
from qjrl.robot.quaternion_arm.mjcf import SolverOptions
from qjrl.robot.quaternion_arm.statics import Equilibrium

Robot = QuaternionArm  # a union once there is a second kind

VERBS = {
    "quaternion_arm": {
        "forward_kinematics": kinematics.forward_kinematics,
        "cable_lengths": cables.cable_lengths,
        "bends_from_cables": cables.bends_from_cables,
        "cable_strokes": cables.cable_strokes,
        "strand_lengths": cables.strand_lengths,
        "strand_commands": cables.strand_commands,
        "equilibrium": statics.equilibrium,
        "strand_tension": statics.strand_tension,
        "is_at_strength": statics.is_at_strength,
        "joint_positions": coordinates.joint_positions,
        "configuration_from_joint_positions": coordinates.bends_from_joint_positions,
        "build_mjcf": mjcf.build_mjcf,
    },
}


def _verb(robot: Robot, name: str):
    if name not in VERBS[robot.kind]:
        raise ValueError(f"robot kind {robot.kind}: offers no {name}, it offers {', '.join(VERBS[robot.kind])}")
    return VERBS[robot.kind][name]


def _one(value: Any, shape: tuple[int, ...], name: str) -> jax.Array:
    """One sample as an array.

    Raises:
        ValueError: it has another shape: JAX's indexing would take some of it, or repeat the last.
    """
    array = jnp.asarray(value)
    if array.shape != shape:
        raise ValueError(f"{name}: got the shape {array.shape}, allowed: {shape}, one sample; jax.vmap maps over many")
    return array


def forward_kinematics(robot: Robot, configuration: jax.Array) -> jax.Array:
    """Nominal tip pose (9,) [m, -] of a configuration, bends (num_segments, 2) for this kind."""
    return _verb(robot, "forward_kinematics")(robot, _one(configuration, (robot.num_segments, 2), "configuration"))


def cable_lengths(robot: Robot, configuration: jax.Array) -> jax.Array:
    """Cable lengths (num_cables,) [m] relative to home, + pays out."""
    return _verb(robot, "cable_lengths")(robot, _one(configuration, (robot.num_segments, 2), "configuration"))


def bends_from_cables(robot: Robot, lengths: jax.Array) -> jax.Array:
    """Configuration whose cable lengths (num_cables,) [m] are given; closed form."""
    return _verb(robot, "bends_from_cables")(robot, _one(lengths, (robot.num_cables,), "lengths"))


def cable_strokes(robot: Robot) -> jax.Array:
    """Largest |cable length| (num_cables,) [m] within the robot's limits."""
    return _verb(robot, "cable_strokes")(robot)


def strand_lengths(robot: Robot, configuration: jax.Array) -> jax.Array:
    """Strand lengths (num_strands,) [m] inside the joints they cross, common part included."""
    return _verb(robot, "strand_lengths")(robot, _one(configuration, (robot.num_segments, 2), "configuration"))


def strand_commands(robot: Robot, lengths: jax.Array) -> jax.Array:
    """Rest lengths (num_strands,) [m] that the motors give the strands: the controls of the MJCF."""
    return _verb(robot, "strand_commands")(robot, _one(lengths, (robot.num_cables,), "lengths"))


def equilibrium(robot: Robot, lengths: jax.Array) -> Equilibrium:
    """Where a robot as described rests when it holds cable lengths (num_cables,) [m], and what would move it from there."""
    return _verb(robot, "equilibrium")(robot, _one(lengths, (robot.num_cables,), "lengths"))


def strand_tension(robot: Robot, lengths: jax.Array, steps: int = statics.STEPS) -> jax.Array:
    """Tension (num_strands,) [N] of a robot as described that rests at cable lengths (num_cables,) [m], without simulation."""
    return _verb(robot, "strand_tension")(robot, _one(lengths, (robot.num_cables,), "lengths"), steps)


def is_at_strength(robot: Robot, tension: Any) -> Any:
    """Whether strands of tensions (...,) [N] are at their strength: the real ones would break."""
    return _verb(robot, "is_at_strength")(robot, tension)


def joint_positions(robot: Robot, configuration: jax.Array) -> jax.Array:
    """Joint positions (nq,) of the MJCF at a configuration, on the constraint manifold."""
    return _verb(robot, "joint_positions")(robot, _one(configuration, (robot.num_segments, 2), "configuration"))


def configuration_from_joint_positions(robot: Robot, positions: jax.Array) -> jax.Array:
    """Configuration nearest to joint positions (nq,) of the MJCF."""
    return _verb(robot, "configuration_from_joint_positions")(robot, positions)


def build_mjcf(robot: Robot, options: SolverOptions = SolverOptions()) -> str:
    """MuJoCo XML of a robot."""
    return _verb(robot, "build_mjcf")(robot, options)


def in_precision(robot: Robot, precision: str) -> Robot:
    """The robot with all its numbers in a precision, "float32" or "float64": what is computed from them stays in it."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, precision), robot)
