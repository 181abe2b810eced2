"""Damped least squares on a robot of any kind, many starts side by side: residual, step, acceptance, end.

It steps in the coordinates of the robot's kind. Components come first and the batch, one a start, last.
"""

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from typing import Annotated

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int

from qjrl.config import Range, configuration
from qjrl.geometry import batch_last, cholesky
from qjrl.robot.kinds import kind_of
from qjrl.robot.limits import Limits
from qjrl.robot.tip import Tip
from qjrl.robot.verbs import Robot
from qjrl.solvers.model_tip import TipFunction, nominal_tip


@configuration
class DescentConfig:
    """One descent from one start; all values ours."""

    rotation_weight: Annotated[float, Range(above=0.0)] = 0.1
    """What a rotation error counts against a position error [m/rad]."""
    damping: Annotated[float, Range(above=0.0)] = 1e-2
    """At the start, times the trace of J^T J."""
    damping_decrease: Annotated[float, Range(above=0.0, below=1.0)] = 0.2
    """Factor after a step that lowers the cost."""
    damping_increase: Annotated[float, Range(above=1.0)] = 4.0
    """Factor after a step that does not; the step is taken back."""
    largest_step: Annotated[float, Range(above=0.0)] = 1.0
    """Bound of a step over all coordinates [rad]."""
    shortest_step: Annotated[float, Range(above=0.0)] = 1e-7
    """A descent whose step is shorter has stalled [rad]."""
    position_tolerance: Annotated[float, Range(above=0.0)] = 1e-5
    """Position error that counts as converged [m] (paper 000, section 5.2)."""
    orientation_tolerance: Annotated[float, Range(above=0.0)] = math.radians(0.01)
    """Orientation error that counts as converged [rad] (the paper evaluates the roll alone)."""
    optimality: Annotated[float, Range(above=0.0, below=1.0)] = 1e-3
    """A pose is the nearest one around when the cosine between its error and every motion left to it is smaller."""


@struct.dataclass
class Residual:
    """Weighted error of a pose and its derivative: to first order, a step d leaves `error` - `jacobian` d."""

    error: Float[Array, "6 batch"]
    """Position [m], then the rotation vector from the pose to the target, weighted [m]."""
    jacobian: Float[Array, "6 coordinates batch"]
    """Of the pose, rows weighted alike [m/rad]."""

    @property
    def cost(self) -> Float[Array, "batch"]:
        """Squared weighted error [m^2]."""
        return jnp.sum(self.error**2, axis=0)


@struct.dataclass
class Descent:
    """Where every start has come to."""

    coordinates: Float[Array, "coordinates batch"]
    """Of the robot's kind, such as bend vectors [rad]."""
    residual: Residual
    damping: Float[Array, "batch"]
    steps: Int[Array, "batch"]
    """Iterations spent."""
    is_near: Bool[Array, "batch"]
    """At the target."""
    has_stalled: Bool[Array, "batch"]
    """Not at the target, and its steps have become too short to get there."""

    @property
    def is_going(self) -> Bool[Array, "batch"]:
        """Whether another step may help."""
        return ~(self.is_near | self.has_stalled)


def descend(
    robot: Robot,
    config: DescentConfig,
    starts: Float[Array, "coordinates batch"],
    targets: Float[Array, "9 batch"],
    iterations: Int[Array, ""],
    tip: TipFunction = nominal_tip,
) -> Descent:
    """Levenberg-Marquardt from every start until all are near or stalled, or for `iterations`.

    `tip` gives poses and Jacobian: the closed form's, or a learned model's (see `model_tip`).
    """
    problem = _Problem(kind_of(robot).limits(robot), config, targets, partial(tip, robot))

    def is_unfinished(carry) -> jax.Array:
        number, state = carry
        return (number < iterations) & jnp.any(state.is_going)

    def advance(carry):
        number, state = carry
        return number + 1, _iterate(problem, state)

    state = _begin(problem, problem.limits.within(starts))
    return jax.lax.while_loop(is_unfinished, advance, (jnp.zeros_like(iterations), state))[1]


def is_nearest(robot: Robot, config: DescentConfig, state: Descent) -> Bool[Array, "batch"]:
    """Whether an answer rests at a constrained minimum: its error is at right angles to every motion left to the joints.

    At the minimum the cosines are 0; those of 1e-3 cost about a millionth of the error (second order).
    """
    free = free_jacobian(kind_of(robot).limits(robot), state.coordinates, state.residual)
    gradient = jnp.abs(jnp.sum(free * state.residual.error[:, None], axis=0))  # (coordinates, batch)
    scale = jnp.sqrt(jnp.sum(state.residual.jacobian**2, axis=0) * state.residual.cost)
    return jnp.all(gradient <= config.optimality * scale, axis=0)


def residual_of(tip: Tip, weight: float, targets: Float[Array, "9 batch"]) -> Residual:
    """Error and Jacobian of a tip; the rotation error is the logarithm on SO(3), weighted [m/rad]."""
    x, y = targets[3:6], targets[6:9]
    turn = batch_last.rotation_vector(tip.rotation, jnp.stack([x, y, batch_last.cross(x, y)], axis=1))
    return Residual(
        jnp.concatenate([targets[:3] - tip.position, weight * turn]),
        jnp.concatenate([tip.velocity, weight * tip.angular_velocity]),
    )


def damped_step(
    residual: Residual, damping: Float[Array, "batch"], largest: float
) -> Float[Array, "coordinates batch"]:
    """The step J^T (J J^T + mu tr(J J^T) I)^-1 e, equal to (J^T J + mu tr I)^-1 J^T e, capped in length [rad].

    The first form is 6 x 6 whatever the number of coordinates.
    """
    normal = jnp.sum(residual.jacobian[:, None] * residual.jacobian[None], axis=2)  # J J^T, (6, 6, batch)
    scaled_damping = damping * sum(normal[i, i] for i in range(6))
    rows = [[normal[i, j] + (scaled_damping if i == j else 0.0) for j in range(i + 1)] for i in range(6)]
    step = jnp.sum(residual.jacobian * cholesky.solve(cholesky.factor(rows), residual.error)[:, None], axis=0)
    return step * jnp.minimum(1.0, largest / jnp.maximum(jnp.sqrt(jnp.sum(step**2, axis=0)), largest))


@dataclasses.dataclass(frozen=True)
class _Problem:
    """What stays the same during a descent."""

    limits: Limits
    config: DescentConfig
    targets: jax.Array
    tip: Callable[[jax.Array], Tip]

    def residual(self, coordinates: jax.Array) -> Residual:
        return residual_of(self.tip(coordinates), self.config.rotation_weight, self.targets)


def _begin(problem: _Problem, coordinates: jax.Array) -> Descent:
    residual = problem.residual(coordinates)
    batch = coordinates.shape[-1:]
    return Descent(
        coordinates,
        residual,
        jnp.full(batch, problem.config.damping, coordinates.dtype),
        jnp.zeros(batch, jnp.int32),
        _is_near(problem.config, residual),
        jnp.zeros(batch, bool),
    )


def _iterate(problem: _Problem, state: Descent) -> Descent:
    """One step of every start that is going; taken back where it does not lower the cost."""
    config, residual = problem.config, state.residual
    free = dataclasses.replace(residual, jacobian=free_jacobian(problem.limits, state.coordinates, residual))
    step = damped_step(free, state.damping, config.largest_step)
    coordinates = problem.limits.within(state.coordinates + step)
    residual = problem.residual(coordinates)
    is_better = (residual.cost < state.residual.cost) & state.is_going
    pick = lambda new, old: jnp.where(is_better, new, old)  # noqa: E731
    moved = jnp.sqrt(jnp.sum((coordinates - state.coordinates) ** 2, axis=0))
    residual = jax.tree.map(pick, residual, state.residual)
    is_near = _is_near(config, residual)
    return Descent(
        pick(coordinates, state.coordinates),
        residual,
        jnp.where(is_better, state.damping * config.damping_decrease, state.damping * config.damping_increase),
        state.steps + state.is_going,
        is_near,
        state.has_stalled | (state.is_going & ~is_near & (moved < config.shortest_step)),
    )


def free_jacobian(limits: Limits, coordinates: jax.Array, residual: Residual) -> jax.Array:
    """The Jacobian without what would carry a coordinate beyond its limit (gradient projection).

    Clipping alone spends the step outward and stops short of the best point on the limit.
    """
    slope = jnp.sum(residual.jacobian * residual.error[:, None], axis=0)
    return limits.free_motions(coordinates, slope, residual.jacobian)


def _is_near(config: DescentConfig, residual: Residual) -> jax.Array:
    position = jnp.sum(residual.error[:3] ** 2, axis=0)
    turn = jnp.sum(residual.error[3:] ** 2, axis=0)
    return (position <= (_MARGIN * config.position_tolerance) ** 2) & (
        turn <= (_MARGIN * config.rotation_weight * config.orientation_tolerance) ** 2
    )


# A descent goes on until its errors are this part of the tolerances: the answer holds when it is recomputed.
_MARGIN = 0.1
