"""The verbs every kind of robot may offer, dispatched on `robot.kind`.

What a verb is given is held against what the robot can have: one sample of the right shape, real, finite, a bend below 180
degrees, lengths in metres. Under `jax.jit`, `jax.vmap` and `jax.grad` there are no values to look at yet, only shapes: there a
bend of |a| >= 1 counts as one just below 180 degrees, whose pose means nothing, and what is not finite stays NaN.
"""

from typing import Any

import jax
import jax.numpy as jnp

from qjrl.config import ConfigError
from qjrl.field_words import show
from qjrl.robot.equilibrium import Equilibrium
from qjrl.robot.kind import Robot as Robot
from qjrl.robot.kinds import kind_of
from qjrl.robot.kinds import verb as _verb
from qjrl.robot.plausibility import check_angles, one_configuration, one_of_lengths, one_of_positions, one_sample
from qjrl.robot.quaternion_arm import joint, statics
from qjrl.robot.solver_options import SolverOptions


def forward_kinematics(robot: Robot, configuration: jax.Array) -> jax.Array:
    """Nominal tip pose (9,) [m, -] of a configuration, bends (num_segments, 2) for this kind."""
    return _verb(robot, "forward_kinematics")(robot, one_configuration(robot, configuration))


def cable_lengths(robot: Robot, configuration: jax.Array) -> jax.Array:
    """Cable lengths (num_cables,) [m] relative to home, + pays out."""
    return _verb(robot, "cable_lengths")(robot, one_configuration(robot, configuration))


def bends_from_cables(robot: Robot, lengths: jax.Array) -> jax.Array:
    """Bends whose cable lengths (num_cables,) [m] are given: `configuration_from_cables` of the quaternion-joint arm."""
    return configuration_from_cables(robot, lengths)


def configuration_from_cables(robot: Robot, lengths: jax.Array) -> jax.Array:
    """Configuration whose cable lengths (num_cables,) [m] are given; closed form."""
    return _verb(robot, "configuration_from_cables")(robot, one_of_lengths(robot, lengths))


def home(robot: Robot) -> jax.Array:
    """Configuration at which all cable lengths are zero."""
    return _verb(robot, "home")(robot)


def within_limits(robot: Robot, configuration: jax.Array) -> jax.Array:
    """The configuration, brought back within the robot's limits."""
    kind = kind_of(robot)
    if kind.within_limits is not None:
        return kind.within_limits(robot, configuration)
    coordinates = kind.coordinates_of(robot, configuration)
    return kind.configuration_of(robot, kind.limits(robot).within(coordinates))


def is_within_limits(robot: Robot, configuration: jax.Array, tolerance: float = 1e-9) -> jax.Array:
    """Whether bringing a configuration back within the limits moves none of its numbers by more than `tolerance`."""
    return jnp.max(jnp.abs(within_limits(robot, configuration) - configuration)) <= tolerance


def cable_strokes(robot: Robot) -> jax.Array:
    """Largest |cable length| (num_cables,) [m] within the robot's limits."""
    return _verb(robot, "cable_strokes")(robot)


def strand_lengths(robot: Robot, configuration: jax.Array) -> jax.Array:
    """Strand lengths (num_strands,) [m] inside the joints they cross, common part included."""
    return _verb(robot, "strand_lengths")(robot, one_configuration(robot, configuration))


def strand_commands(robot: Robot, lengths: jax.Array) -> jax.Array:
    """Rest lengths (num_strands,) [m] that the motors give the strands: the controls of the MJCF."""
    return _verb(robot, "strand_commands")(robot, one_of_lengths(robot, lengths))


def equilibrium(robot: Robot, lengths: jax.Array) -> Equilibrium:
    """Where a robot as described rests when it holds cable lengths (num_cables,) [m], and what would move it from there."""
    return _verb(robot, "equilibrium")(robot, one_of_lengths(robot, lengths))


def strand_tension(robot: Robot, lengths: jax.Array, steps: int = statics.STEPS) -> jax.Array:
    """Tension (num_strands,) [N] of a robot as described that rests at cable lengths (num_cables,) [m], without simulation."""
    if not isinstance(steps, int) or isinstance(steps, bool) or steps < 1:
        raise ConfigError(f"steps: got {show(steps)}, allowed: an integer from 1")
    return _verb(robot, "strand_tension")(robot, one_of_lengths(robot, lengths), steps)


def is_at_strength(robot: Robot, tension: Any) -> Any:
    """Whether strands of tensions (...,) [N] are at their strength: the real ones would break."""
    return _verb(robot, "is_at_strength")(robot, tension)


def joint_positions(robot: Robot, configuration: jax.Array) -> jax.Array:
    """Joint positions (nq,) of the MJCF at a configuration, on the constraint manifold."""
    return _verb(robot, "joint_positions")(robot, one_configuration(robot, configuration))


def configuration_from_joint_positions(robot: Robot, positions: jax.Array) -> jax.Array:
    """Configuration nearest to joint positions (nq,) of the MJCF."""
    return _verb(robot, "configuration_from_joint_positions")(robot, one_of_positions(robot, positions))


def bends_from_angles(direction: Any, angle: Any) -> jax.Array:
    """Bends (..., 2) from bend direction phi and bend angle theta (...,) [rad], theta up to 180 degrees."""
    check_angles(angle, "angle")
    return joint.bends_from_angles(jnp.asarray(direction), jnp.asarray(angle))


def bends_from_pose(joint_pose: jax.Array) -> jax.Array:
    """Bend (2,) of one joint from the pose (9,) of its upper plate in the lower one's frame [m, -]."""
    return joint.bends_from_pose(one_sample(joint_pose, (9,), "joint_pose"))


def build_mjcf(robot: Robot, options: SolverOptions = SolverOptions()) -> str:
    """MuJoCo XML of a robot."""
    return _verb(robot, "build_mjcf")(robot, options)


def in_precision(robot: Robot, precision: str) -> Robot:
    """The robot with all its numbers in a precision, "float32" or "float64": what is computed from them stays in it."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, precision), robot)
