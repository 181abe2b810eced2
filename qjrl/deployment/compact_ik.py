"""Inverse kinematics of a fixed cost for a controller: damped Gauss-Newton on the model from a few stored starts.

The unknowns are the bends, each segment's in units of its limit, so that a limit is the unit disc. Only elementary
operations: what LAPACK or a sort would do is written out, since an exported file must run on any platform.
"""

import dataclasses
import math
from typing import Annotated

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.config import Range
from qjrl.deployment.functions import Outputs, SolveFunction
from qjrl.geometry.pose import orientation_error, position_error
from qjrl.robot.forward_model import PoseFunction
from qjrl.robot.quaternion_arm.sampling import bends_from_unit_cube
from qjrl.robot.verbs import Robot, cable_lengths


@dataclasses.dataclass(frozen=True)
class CompactIKConfig:
    """Size and tolerances; all values ours."""

    num_candidates: Annotated[int, Range(1, 100_000)] = 8192
    """Random poses stored in the file."""
    num_starts: Annotated[int, Range(1, 256)] = 8
    """Descents of every target: the candidates are dealt into so many groups, and the nearest of each group starts."""
    iterations: Annotated[int, Range(1, 1000)] = 15
    """Steps of every descent, always all of them."""
    damping: Annotated[float, Range(above=0.0)] = 1e-3
    """At the start, times the mean diagonal of J J^T."""
    position_scale: Annotated[float, Range(above=0.0)] = 0.01
    """Position error that costs 1 [m]."""
    orientation_scale: Annotated[float, Range(above=0.0)] = 0.05
    """Orientation error that costs about 1 [rad]."""
    position_tolerance: Annotated[float, Range(above=0.0)] = 1e-4
    """Predicted position error that counts as converged [m]."""
    orientation_tolerance: Annotated[float, Range(above=0.0)] = math.radians(0.05)
    """Predicted orientation error that counts as converged [rad]."""

    def __post_init__(self):
        if self.num_candidates < self.num_starts:
            raise ValueError(
                f"num_candidates: got {self.num_candidates}, allowed: at least num_starts = {self.num_starts}"
            )


@struct.dataclass
class _Descent:
    """Where one descent stands; all arrays of one start."""

    scaled: jax.Array  # (coordinates,) bends in units of their limit
    residual: jax.Array  # (9,)
    jacobian: jax.Array  # (9, coordinates)
    damping: jax.Array


def compact_ik(robot: Robot, model: PoseFunction, config: CompactIKConfig, seed: int) -> SolveFunction:
    """The solver of one robot and model, its candidates drawn.

    Args:
        robot: in the precision in which it shall compute.
        model: lengths (num_cables,) [m] -> pose (9,), in the same precision.
        config: starts, steps, tolerances.
        seed: of the candidates.
    """
    candidates = _candidates(robot, config, seed)
    reached = jax.jit(jax.vmap(jax.vmap(lambda scaled: _features(config, model(_lengths(robot, scaled))))))
    features = reached(candidates)

    def solve(target: jax.Array) -> Outputs:
        error = lambda scaled: _features(config, model(_lengths(robot, scaled)) - target)  # noqa: E731
        starts = _nearest_of_groups(candidates, features, _features(config, target))
        ends = jax.vmap(lambda start: _descend(error, start, config, robot.num_segments))(starts)
        answers = jax.vmap(lambda scaled: _answer(robot, model, config, target, scaled))(ends.scaled)
        best = _preferred(ends, answers["converged"], robot.num_segments)
        return jax.tree.map(lambda rows: rows[best], answers)

    return solve


def _preferred(ends: _Descent, converged: jax.Array, num_segments: int) -> jax.Array:
    """Which start to believe: of those that converged the one with the smallest bends, else the nearest.

    The nearest of several redundant answers would be chosen by rounding alone, and jump from target to target.
    """
    largest = num_segments  # of the squared bends in units of their limits
    return jnp.argmin(
        jnp.where(converged, jnp.sum(ends.scaled**2, axis=1), largest + jnp.sum(ends.residual**2, axis=1))
    )


def _candidates(robot: Robot, config: CompactIKConfig, seed: int) -> jax.Array:
    """(starts, candidates of a group, coordinates) feasible bends in units of their limit."""
    shape = (config.num_starts, config.num_candidates // config.num_starts, robot.num_cables)
    numbers = jax.random.uniform(jax.random.key(seed), shape, robot.bend_limit.dtype)
    draw = lambda row: bends_from_unit_cube(robot, row).reshape(-1) / jnp.sin(robot.bend_limit / 2.0)  # noqa: E731
    return jax.vmap(jax.vmap(draw))(numbers)


def _lengths(robot: Robot, scaled: jax.Array) -> jax.Array:
    return cable_lengths(robot, scaled.reshape(-1, 2) * jnp.sin(robot.bend_limit / 2.0))


def _features(config: CompactIKConfig, pose: jax.Array) -> jax.Array:
    """A pose or a difference of poses, such that squared distances are the cost."""
    return jnp.concatenate([pose[:3] / config.position_scale, pose[3:] / config.orientation_scale])


def _nearest_of_groups(candidates: jax.Array, features: jax.Array, wanted: jax.Array) -> jax.Array:
    """The nearest candidate of every group, (starts, coordinates)."""
    distances = jnp.sum((features - wanted) ** 2, axis=2)
    return jax.vmap(lambda group, distance: group[jnp.argmin(distance)])(candidates, distances)


def _descend(error, start: jax.Array, config: CompactIKConfig, num_segments: int) -> _Descent:
    """Levenberg-Marquardt: a step that does not lower the cost is taken back and damped more."""

    def evaluate(scaled: jax.Array) -> tuple[jax.Array, jax.Array]:
        basis = jnp.eye(scaled.size, dtype=scaled.dtype)
        return jax.vmap(lambda tangent: jax.jvp(error, (scaled,), (tangent,)), out_axes=(None, 1))(basis)

    def iterate(_, state: _Descent) -> _Descent:
        scaled = _within_limit(state.scaled - _damped_step(state), num_segments)
        residual, jacobian = evaluate(scaled)
        cost = jnp.sum(state.residual**2)
        is_better = (jnp.sum(residual**2) < cost) & (cost > _good_enough(config))
        damping = state.damping * jnp.where(is_better, decrease, increase)
        damping = jnp.maximum(damping, _LEAST_DAMPING)
        better, worse = _Descent(scaled, residual, jacobian, damping), dataclasses.replace(state, damping=damping)
        return jax.tree.map(lambda new, old: jnp.where(is_better, new, old), better, worse)

    decrease, increase = jnp.array([_DAMPING_DECREASE, _DAMPING_INCREASE], start.dtype)
    begin = _Descent(start, *evaluate(start), jnp.asarray(config.damping, start.dtype))
    return jax.lax.fori_loop(0, config.iterations, iterate, begin)


def _damped_step(state: _Descent) -> jax.Array:
    """J^T (J J^T + mu I)^-1 r, equal to (J^T J + mu I)^-1 J^T r: rounding cannot move it along the redundant directions."""
    normal = state.jacobian @ state.jacobian.T  # (9, 9)
    weight = state.damping * jnp.mean(jnp.diagonal(normal))
    damped = normal + weight * jnp.eye(len(normal), dtype=normal.dtype)
    return state.jacobian.T @ solve_positive(damped, state.residual)


def _good_enough(config: CompactIKConfig) -> float:
    """Cost below which a descent rests: further steps would follow rounding."""
    tolerances = (
        config.position_tolerance / config.position_scale,
        config.orientation_tolerance / config.orientation_scale,
    )
    return (_MARGIN * min(tolerances)) ** 2


def solve_positive(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """x of matrix x = right for a symmetric positive definite (n, n): Gauss-Jordan, which needs no pivoting there."""
    size = len(right)
    rows, identity = jnp.concatenate([matrix, right[:, None]], axis=1), jnp.eye(size, dtype=matrix.dtype)
    for k in range(size):
        pivot = rows[k] / rows[k, k]
        rows = rows - jnp.outer(rows[:, k] - identity[k], pivot)
    return rows[:, -1]


def _within_limit(scaled: jax.Array, num_segments: int) -> jax.Array:
    """Each segment's bend shortened to its limit."""
    bends = scaled.reshape(num_segments, 2)
    squared = jnp.maximum(jnp.sum(bends**2, axis=1, keepdims=True), 1.0)
    return (bends / jnp.sqrt(squared)).reshape(-1)


def _answer(
    robot: Robot, model: PoseFunction, config: CompactIKConfig, target: jax.Array, scaled: jax.Array
) -> Outputs:
    lengths = _lengths(robot, scaled)
    pose = model(lengths)
    position, orientation = position_error(pose, target), orientation_error(pose, target)
    is_near = (position <= config.position_tolerance) & (orientation <= config.orientation_tolerance)
    return {
        "cable_lengths": lengths,
        "position_error": position,
        "orientation_error": orientation,
        "converged": is_near,
    }


_DAMPING_DECREASE, _DAMPING_INCREASE = 0.2, 4.0
# Errors in tolerances at which a descent rests.
_MARGIN = 0.02
# Below it single precision cannot solve for a step: J has no rank beyond the six degrees of freedom of a pose.
_LEAST_DAMPING = 1e-5
