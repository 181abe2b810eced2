"""Damped least squares on the arm, many starts side by side: residual, step, acceptance, end.

Components come first and the batch, one a start, last (see `qjrl.robot.quaternion_arm.differential`).
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
from qjrl.robot.quaternion_arm.differential import Tip, tip_of
from qjrl.robot.verbs import Robot
from qjrl.solvers.model_tip import TipFunction


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
    """Bound of a step over all bend vectors [rad]."""
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

    vectors: Float[Array, "segments 2 batch"]
    """Bend vectors theta_k (cos phi_k, sin phi_k) [rad]."""
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
    starts: Float[Array, "segments 2 batch"],
    targets: Float[Array, "9 batch"],
    iterations: Int[Array, ""],
    tip: TipFunction = tip_of,
) -> Descent:
    """Levenberg-Marquardt from every start until all are near or stalled, or for `iterations`.

    `tip` gives poses and Jacobian: the closed form's, or a learned model's (see `model_tip`).
    """
    problem = _Problem(robot, config, targets, partial(tip, robot))

    def is_unfinished(carry) -> jax.Array:
        number, state = carry
        return (number < iterations) & jnp.any(state.is_going)

    def advance(carry):
        number, state = carry
        return number + 1, _iterate(problem, state)

    state = _begin(problem, within_limit(robot, starts))
    return jax.lax.while_loop(is_unfinished, advance, (jnp.zeros_like(iterations), state))[1]


def is_nearest(robot: Robot, config: DescentConfig, state: Descent) -> Bool[Array, "batch"]:
    """Whether an answer rests at a constrained minimum: its error is at right angles to every motion left to the joints.

    At the minimum the cosines are 0; those of 1e-3 cost about a millionth of the error (second order).
    """
    held = _hold_at_limit(robot, state.vectors, state.residual)
    gradient = jnp.abs(jnp.sum(held.jacobian * held.error[:, None], axis=0))  # (coordinates, batch)
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

    The first form is 6 x 6 whatever the number of segments.
    """
    normal = jnp.sum(residual.jacobian[:, None] * residual.jacobian[None], axis=2)  # J J^T, (6, 6, batch)
    scaled_damping = damping * sum(normal[i, i] for i in range(6))
    rows = [[normal[i, j] + (scaled_damping if i == j else 0.0) for j in range(i + 1)] for i in range(6)]
    step = jnp.sum(residual.jacobian * cholesky.solve(cholesky.factor(rows), residual.error)[:, None], axis=0)
    return step * jnp.minimum(1.0, largest / jnp.maximum(jnp.sqrt(jnp.sum(step**2, axis=0)), largest))


def within_limit(robot: Robot, vectors: Float[Array, "segments 2 batch"]) -> Float[Array, "segments 2 batch"]:
    """Bend vectors with each theta shortened to the bend limit."""
    limit = robot.bend_limit.astype(vectors.dtype)
    angle = jnp.sqrt(jnp.maximum(jnp.sum(vectors**2, axis=1, keepdims=True), limit**2))
    return vectors * (limit / angle)


@dataclasses.dataclass(frozen=True)
class _Problem:
    """What stays the same during a descent."""

    robot: Robot
    config: DescentConfig
    targets: jax.Array
    tip: Callable[[jax.Array], Tip]

    def residual(self, vectors: jax.Array) -> Residual:
        return residual_of(self.tip(vectors), self.config.rotation_weight, self.targets)


def _begin(problem: _Problem, vectors: jax.Array) -> Descent:
    residual = problem.residual(vectors)
    batch = vectors.shape[-1:]
    return Descent(
        vectors,
        residual,
        jnp.full(batch, problem.config.damping, vectors.dtype),
        jnp.zeros(batch, jnp.int32),
        _is_near(problem.config, residual),
        jnp.zeros(batch, bool),
    )


def _iterate(problem: _Problem, state: Descent) -> Descent:
    """One step of every start that is going; taken back where it does not lower the cost."""
    robot, config = problem.robot, problem.config
    held = _hold_at_limit(robot, state.vectors, state.residual)
    step = damped_step(held, state.damping, config.largest_step)
    vectors = within_limit(robot, state.vectors + step.reshape(state.vectors.shape))
    residual = problem.residual(vectors)
    is_better = (residual.cost < state.residual.cost) & state.is_going
    pick = lambda new, old: jnp.where(is_better, new, old)  # noqa: E731
    moved = jnp.sqrt(jnp.sum((vectors - state.vectors) ** 2, axis=(0, 1)))
    residual = jax.tree.map(pick, residual, state.residual)
    is_near = _is_near(config, residual)
    return Descent(
        pick(vectors, state.vectors),
        residual,
        jnp.where(is_better, state.damping * config.damping_decrease, state.damping * config.damping_increase),
        state.steps + state.is_going,
        is_near,
        state.has_stalled | (state.is_going & ~is_near & (moved < config.shortest_step)),
    )


def _hold_at_limit(robot: Robot, vectors: jax.Array, residual: Residual) -> Residual:
    """Takes out of the Jacobian what would bend a joint at its limit further (gradient projection).

    Clipping alone spends the step outward and stops short of the best point on the limit.
    """
    flat = residual.jacobian.reshape(6, *vectors.shape)  # (6, segments, 2, batch)
    gradient = jnp.sum(flat * residual.error[:, None, None], axis=0)
    squared = jnp.sum(vectors**2, axis=1)
    is_held = (squared >= (robot.bend_limit * _AT_LIMIT) ** 2) & (jnp.sum(gradient * vectors, axis=1) > 0)
    outward = (
        vectors * jnp.where(is_held, 1.0 / jnp.maximum(squared, (robot.bend_limit * _AT_LIMIT) ** 2), 0.0)[:, None]
    )
    radial = jnp.sum(flat * vectors, axis=2, keepdims=True)  # (6, segments, 1, batch)
    return dataclasses.replace(residual, jacobian=(flat - radial * outward).reshape(residual.jacobian.shape))


def _is_near(config: DescentConfig, residual: Residual) -> jax.Array:
    position = jnp.sum(residual.error[:3] ** 2, axis=0)
    turn = jnp.sum(residual.error[3:] ** 2, axis=0)
    return (position <= (_MARGIN * config.position_tolerance) ** 2) & (
        turn <= (_MARGIN * config.rotation_weight * config.orientation_tolerance) ** 2
    )


# A descent goes on until its errors are this part of the tolerances: the answer holds when it is recomputed.
_MARGIN = 0.1
# A joint this close to its limit counts as at it: clipping leaves it there to rounding.
_AT_LIMIT = 1.0 - 1e-6
