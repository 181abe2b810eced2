"""Points of a path in a CSV or NPZ file, checked, and the smooth curve through them."""

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from qjrl.config import ConfigError
from qjrl.robot.plausibility import check_positions
from qjrl.robot.verbs import Robot
from qjrl.table_file import Layout, Quantity, read_table

_AXES, _COLUMNS = ("x", "y", "z"), ("xx", "xy", "xz", "yx", "yy", "yz")
_NOTE = ", of the 3 x 3 matrix the first column, then the second"
_POSE_NOTE = ", position, then of the 3 x 3 matrix the first column, then the second"
POSITION = Quantity("position", _AXES, "m")
QUATERNION = Quantity("quaternion", ("qw", "qx", "qy", "qz"), note=", w first")
"""Without names, in an NPZ, w comes first."""
ROTATION = Quantity("rotation", _COLUMNS, note=_NOTE)
"""The first two columns of the rotation."""
POSE = Quantity("pose", ("pose x", "pose y", "pose z", *_COLUMNS), note=_POSE_NOTE)
"""Of an NPZ: position and rotation in one array."""
POSE_LAYOUTS: tuple[Layout, ...] = ((POSITION,), (POSITION, QUATERNION), (POSITION, ROTATION), (POSE,))
ALLOWED_COLUMNS = f"{','.join(_AXES)} [m], alone or with {','.join(QUATERNION.columns)} or with {','.join(_COLUMNS)}"


@dataclasses.dataclass(frozen=True)
class Points:
    """What a file holds."""

    position: np.ndarray
    """(n, 3) [m]."""
    rotation: Rotation | None
    """None: the file says nothing about it."""


def read_points(path: Path, robot: Robot | None = None) -> Points:
    """Points of a file; `make_path` says what it must hold.

    Args:
        robot: whose reach the positions are held against, where it is known.
    Raises:
        ConfigError: one line that names the file and what is wrong in it.
    """
    found = read_table(path, POSE_LAYOUTS, ALLOWED_COLUMNS)
    position, turn = found.get("position"), found.get("quaternion", found.get("rotation"))
    if position is None:
        position, turn = found["pose"][:, :3], found["pose"][:, 3:]
    if len(position) < 2:
        raise ConfigError(f"{path}: holds {len(position)} points, allowed: at least 2")
    if robot is not None:
        check_positions(robot, position, str(path), noun="point")
    points = Points(position, None if turn is None else _rotations(path, turn))
    steps = _steps(points)
    if (steps < 1e-9).any():
        row = int(np.argmin(steps))
        raise ConfigError(f"{path}: points {row} and {row + 1} are the same (the first is 0)")
    return points


def smooth_curve(points: Points) -> Callable[[np.ndarray], tuple[np.ndarray, Rotation | None]]:
    """The curve through all points with continuous velocity and acceleration, its parameter from 0 to 1.

    Cubic splines over the distance between points: of the positions, and of the rotations as scipy's RotationSpline.
    """
    knots = np.concatenate([[0.0], np.cumsum(_steps(points))])
    knots /= knots[-1]
    position = CubicSpline(knots, points.position, bc_type="not-a-knot" if len(knots) > 3 else "natural")
    if points.rotation is None:
        return lambda parameter: (position(parameter), None)
    rotation = RotationSpline(knots, points.rotation)
    return lambda parameter: (position(parameter), rotation(parameter))


def _steps(points: Points) -> np.ndarray:
    """Distances of neighbours (n - 1,) [m], a turn counts 0.1 m/rad."""
    steps = np.linalg.norm(np.diff(points.position, axis=0), axis=1)
    if points.rotation is None:
        return steps
    return np.hypot(steps, 0.1 * (points.rotation[:-1].inv() * points.rotation[1:]).magnitude())


def _rotations(path: Path, turn: np.ndarray) -> Rotation:
    """Rotations of quaternions (n, 4), w first, or of two columns (n, 6)."""
    if turn.shape[1] == 4:
        size = np.abs(np.linalg.norm(turn, axis=1) - 1.0)
        _refuse_rows(path, size > 1e-3, "is no unit quaternion")
        return Rotation.from_quat(turn, scalar_first=True)
    x, y = turn[:, :3], turn[:, 3:]
    gram = np.stack([np.sum(a * b, axis=1) for a, b in itertools.combinations_with_replacement((x, y), 2)], axis=1)
    _refuse_rows(
        path,
        np.abs(gram - [1.0, 0.0, 1.0]).max(axis=1) > 1e-3,
        f"is no rotation: its columns are not orthonormal; allowed{_NOTE.replace(',', ':', 1)},",
    )
    return Rotation.from_matrix(np.stack([x, y, np.cross(x, y)], axis=2))


def _refuse_rows(path: Path, is_bad: np.ndarray, what: str) -> None:
    if is_bad.any():
        raise ConfigError(f"{path}: point {int(np.argmax(is_bad))} (the first is 0) {what} to 1e-3")
