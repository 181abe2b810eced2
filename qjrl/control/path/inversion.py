"""Inverse kinematics of a whole path at once: every waypoint is met, and what freedom is left makes the cables smooth.

A chain of descents on the closed form finds where the arm can run along the path; Gauss-Newton over the cables of all
waypoints together (block-banded normal equations) then trades, over the arc length s and with c = 50 mm,

    integral of  travel c^2 |du/ds|^2 + curvature c^4 |d^2u/ds^2|^2 + posture |u|^2

against pose errors, which weigh so much that nanometres are left of them. A closed path ends as it began.
"""

import dataclasses
import functools
import math
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array, diags_array, eye_array, vstack

from qjrl.config import ConfigError, Range, configuration
from qjrl.control.path.chains import chained
from qjrl.control.path.errors import path_errors, pose_residual
from qjrl.control.path.paths import ROTATION_WEIGHT, PosePath
from qjrl.robot import bends_from_cables
from qjrl.robot.plausibility import check_positions
from qjrl.robot.pose_model import ClosedForm, PoseFunction, as_model, model_poses, or_closed_form
from qjrl.robot.verbs import Robot


@configuration
class PathInversionConfig:
    """How the redundancy is used; all values ours."""

    travel: Annotated[float, Range(low=0.0)] = 1.0
    """Weight of the cables' travel."""
    curvature: Annotated[float, Range(low=0.0)] = 1.0
    """Weight of the cables' second derivative along the path."""
    posture: Annotated[float, Range(above=0.0)] = 0.1
    """Weight of the cables' distance from home: the arm stays as straight as the path allows."""
    limit_share: Annotated[float, Range(above=0.0, high=1.0)] = 0.97
    """Bends (sine of half the angle) beyond this share of the limit are pushed back."""
    num_starts: Annotated[int, Range(1, 4096)] = 32
    """Configurations at which chains begin: home and random ones; the calmest chain that reaches all waypoints wins."""
    iterations: Annotated[int, Range(1, 1000)] = 100
    """Gauss-Newton steps at most."""
    position_tolerance: Annotated[float, Range(above=0.0)] = 1e-5
    """Error of a waypoint on the model that counts as reached [m]."""
    orientation_tolerance: Annotated[float, Range(above=0.0)] = math.radians(0.01)
    """[rad]."""


@dataclasses.dataclass(frozen=True)
class CablePath:
    """Cable lengths over the distance along a path."""

    lengths: BSpline
    """distance [m] -> (num_cables,) [m]."""
    position_error: np.ndarray
    """(n,) of the waypoints on the model [m]."""
    orientation_error: np.ndarray
    """(n,) [rad]; 0 where orientation does not count."""


def invert_path(
    robot: Robot, model: PoseFunction | None, path: PosePath, config: PathInversionConfig, seed: int = 0
) -> CablePath:
    """Smooth cable lengths whose poses under `model` (None: the closed form) are those of the path.

    Raises:
        ConfigError: some waypoints cannot be reached; one line that says which, and by how far they are missed.
    """
    check_positions(robot, path.pose[:, :3], path.key, noun="waypoint")
    pose_of = or_closed_form(robot, as_model(model))
    lengths = chained(robot, path, config.num_starts, seed)
    missed = path_errors(path.constraint, model_poses(pose_of, lengths), path.pose)
    if missed[0].max() > _HOPELESS:  # far more than a model differs from the closed form
        _refuse_unreachable(robot, path, config, lengths, *missed)
    lengths = _smoothed(robot, pose_of, path, config, lengths)
    position, orientation = path_errors(path.constraint, model_poses(pose_of, lengths), path.pose)
    _refuse_unreachable(robot, path, config, lengths, position, orientation)
    return CablePath(make_interp_spline(path.distance, lengths, k=5), position, orientation)


def _refuse_unreachable(robot, path: PosePath, config: PathInversionConfig, lengths, position, orientation) -> None:
    bends = np.asarray(jax.vmap(lambda row: bends_from_cables(robot, row))(jnp.asarray(lengths)))
    is_outside = np.linalg.norm(bends, axis=2).max(axis=1) > np.sin(float(robot.bend_limit) / 2.0) + 1e-9
    is_far = (position > config.position_tolerance) | (orientation > config.orientation_tolerance)
    missed = np.flatnonzero(is_far | is_outside)
    if len(missed) == 0:
        return
    first, worst = missed[0], missed[np.argmax(position[missed] + ROTATION_WEIGHT * orientation[missed])]
    raise ConfigError(
        f"{path.key}: {len(missed)} of {len(position)} waypoints cannot be reached, the first is number {first} at "
        f"{1e3 * path.distance[first]:.1f} mm along the path; number {worst} is missed by {1e3 * position[worst]:.2f} mm "
        f"and {np.degrees(orientation[worst]):.2f} deg"
        + (", with a joint beyond its limit" if is_outside[missed].any() else "")
    )


def _smoothed(
    robot: Robot, pose_of: PoseFunction, path: PosePath, config: PathInversionConfig, lengths: np.ndarray
) -> np.ndarray:
    """Gauss-Newton over all waypoints; where its steps do not shrink, a proximal term holds them back."""
    spacing, num_cables = float(path.distance[1] - path.distance[0]), lengths.shape[1]
    roughness, weight = _roughness(len(lengths), spacing, config), _POSE_WEIGHT * spacing
    closing = _closing(len(lengths), spacing, config, path.is_closed)
    proximal, previous = 0.0, np.inf
    for _ in range(config.iterations):
        blocks, right = _waypoint_terms(pose_of, path.constraint, config, robot, jnp.asarray(lengths), path.pose)
        normal = _banded(roughness, num_cables)
        normal[0] += proximal * spacing
        _add_blocks(normal, weight * np.asarray(blocks))
        step = -_solve(normal, closing, roughness @ lengths + weight * np.asarray(right), weight, lengths)
        size = float(np.abs(step).max())
        lengths = lengths + step * min(1.0, _LARGEST_STEP / size)
        if size < _SHORTEST_STEP:
            break
        proximal = max(3.0 * proximal, 0.1) if size > 0.9 * previous else 0.8 * proximal
        previous = size
    return lengths


@functools.partial(jax.jit, static_argnums=(1, 2))
def _waypoint_terms(pose_of: PoseFunction, constraint, config: PathInversionConfig, robot: Robot, lengths, targets):
    """J^T J (n, cables, cables) and J^T r (n, cables) of pose errors and bend limits; J is the closed form's."""
    nominal = ClosedForm(robot)
    soft = config.limit_share * jnp.sin(robot.bend_limit / 2.0)

    def rows(pose_of, row, target):
        squared = jnp.sum(bends_from_cables(robot, row) ** 2, axis=1)
        limits = _LIMIT_WEIGHT * jnp.maximum(squared - soft**2, 0.0)
        return jnp.concatenate([pose_residual(constraint, pose_of(row), target), limits])

    def terms(row, target):
        error, jacobian = rows(pose_of, row, target), jax.jacfwd(lambda row: rows(nominal, row, target))(row)
        return jacobian.T @ jacobian, jacobian.T @ error

    return jax.vmap(terms)(lengths, targets)


def _roughness(count: int, spacing: float, config: PathInversionConfig) -> csr_array:
    """Second derivative (n, n) of half the integral in the module's docstring, of one cable."""
    first = diags_array([-1.0, 1.0], offsets=[0, 1], shape=(count - 1, count)) / spacing  # pyright: ignore[reportArgumentType]
    second = diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(count - 2, count)) / spacing**2  # pyright: ignore[reportArgumentType]
    bent = config.curvature * _SCALE**4 * second.T @ second
    return csr_array(spacing * (config.posture * eye_array(count) + config.travel * _SCALE**2 * first.T @ first + bent))


def _closing(count: int, spacing: float, config: PathInversionConfig, is_closed: bool) -> csr_array:
    """Rows of what a closed path keeps small too: a cable's change from begin to end, as strictly as poses, and its
    second derivative across the seam, as all others."""
    share = math.sqrt(config.curvature / _POSE_WEIGHT) * _SCALE**2 / spacing**2
    change = csr_array(([-1.0, 1.0], ([0, 0], [0, count - 1])), shape=(1, count))
    seam = csr_array(([share, -share, -share, share], ([0] * 4, [1, 0, count - 1, count - 2])), shape=(1, count))
    return csr_array(vstack([change, seam]))[: 2 if is_closed else 0]


def _solve(
    normal: np.ndarray, closing: csr_array, gradient: np.ndarray, weight: float, lengths: np.ndarray
) -> np.ndarray:
    """(normal + weight C^T C)^-1 (gradient + weight C^T C lengths): banded, closed by Woodbury's formula."""
    factor, shape = (cholesky_banded(normal, lower=True), True), lengths.shape
    gradient = gradient + weight * (closing.T @ (closing @ lengths))
    solution = cho_solve_banded(factor, gradient.reshape(-1)).reshape(shape)
    if closing.nnz == 0:
        return solution
    columns = np.kron(closing.toarray(), np.eye(shape[1]))  # (2 cables, n cables)
    inverse = cho_solve_banded(factor, columns.T)
    small = np.eye(len(columns)) / weight + columns @ inverse
    return solution - (inverse @ np.linalg.solve(small, columns @ solution.reshape(-1))).reshape(shape)


def _banded(roughness: csr_array, num_cables: int) -> np.ndarray:
    """The same for every cable, as the lower bands (3 cables, n cables) of a matrix of the cables of all waypoints."""
    count = len(roughness.diagonal())
    banded = np.zeros((3 * num_cables, count * num_cables))
    for offset in range(3):
        diagonal = np.concatenate([roughness.diagonal(-offset), np.zeros(offset)])
        banded[offset * num_cables] = np.repeat(diagonal, num_cables)
    return banded


def _add_blocks(banded: np.ndarray, blocks: np.ndarray) -> None:
    """Add (n, cables, cables) to the diagonal of a banded (lower) matrix."""
    num_cables = blocks.shape[1]
    for offset in range(num_cables):
        for column in range(num_cables - offset):
            banded[offset, column::num_cables] += blocks[:, column + offset, column]


# Length that derivatives along the path are compared at [m].
_SCALE = 0.05
# Pose errors [m^2] against roughness [m^2] of the cables.
_POSE_WEIGHT = 1e7
# Turns the excess of squared bends into metres.
_LIMIT_WEIGHT = 0.03
# Of a Gauss-Newton step, any cable [m].
_LARGEST_STEP = 0.005
# A chain that misses a waypoint by more [m] has found no way.
_HOPELESS = 0.03
# Of the last: what is left to gain in smoothness is nothing, and errors are far below it.
_SHORTEST_STEP = 2e-6
