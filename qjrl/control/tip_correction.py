"""What the cables must do to move the tip a little: the closed form's Jacobian, inverted with damping.

The classical baseline of the residual policy integrates what the encoders say the tip lacks, through this matrix.
"""

from typing import Annotated

import jax
import jax.numpy as jnp

from qjrl.config import Range, configuration
from qjrl.control.sensors import sensed_configuration
from qjrl.geometry import cholesky
from qjrl.geometry.pose import pose_difference
from qjrl.robot.verbs import Robot, configuration_from_cables, forward_kinematics

# A rotation of 1 rad weighs as much as a shift of this many metres.
LEVER = 0.1


@configuration
class IntegralConfig:
    """Integral feedback from the encoders, the classical baseline; ours, tuned for the default noise, see experiments/residual."""

    gain: Annotated[float, Range(low=0.0)] = 1.0
    """Share of the missing pose that is made up a second [1/s]; 0 switches it off."""
    bound: Annotated[float, Range(above=0.0)] = 0.01
    """Largest correction of a cable [m]."""


def tip_error(pose: jax.Array, target: jax.Array) -> jax.Array:
    """What a pose (9,) lacks of a target (9,): (6,) [m], the rotation vector times `LEVER`."""
    return pose_difference(pose, target) * jnp.array([1.0, 1.0, 1.0, LEVER, LEVER, LEVER], pose.dtype)


def damped_pseudo_inverse(robot: Robot, lengths: jax.Array, damping: float = 1.0) -> jax.Array:
    """(num_cables, 6): cable lengths [m] for each metre of `tip_error`, around `lengths` (num_cables,) [m].

    J^T (J J^T + damping^2)^-1. A cable moves the tip by ten times its own length where it moves it much, so that a
    damping of 1 leaves those directions alone and keeps out those in which the arm, straight as it is at home, cannot move.
    """
    here = _tip(robot, lengths)
    jacobian = -jax.jacobian(lambda moved: tip_error(_tip(robot, moved), here))(lengths)
    damped = jacobian @ jacobian.T + damping**2 * jnp.eye(6, dtype=jacobian.dtype)
    return cholesky.solve(cholesky.factor(damped), jacobian).T


def sensed_pose(robot: Robot, reading: jax.Array) -> jax.Array:
    """Pose (9,) of the tip by the encoders' estimate [rad]: links are rigid, so the kinematics is exact."""
    return forward_kinematics(robot, sensed_configuration(robot, reading))


def integrate(
    config: IntegralConfig,
    gain: jax.Array,
    integral: jax.Array,
    correction: jax.Array,
    difference: jax.Array,
    period: float,
) -> jax.Array:
    """The integral (num_cables,) [m] one control period [s] later, with a gain [1/s], from `tip_error` (6,)."""
    moved = integral + gain * period * (correction @ difference)
    return jnp.clip(moved, -config.bound, config.bound)


def _tip(robot: Robot, lengths: jax.Array) -> jax.Array:
    return forward_kinematics(robot, configuration_from_cables(robot, lengths))
