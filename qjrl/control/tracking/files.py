"""Points of a path in a CSV or NPZ file, checked, and the smooth curve through them."""

import csv
import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from qjrl import artifacts
from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError

FILE_KINDS = (".csv", ".npz")
POSITION, QUATERNION, COLUMNS = ["x", "y", "z"], ["qw", "qx", "qy", "qz"], ["xx", "xy", "xz", "yx", "yy", "yz"]
"""Names of a CSV's columns; COLUMNS are the first two columns of the rotation."""
ALLOWED_COLUMNS = f"{','.join(POSITION)} [m], alone or with {','.join(QUATERNION)} or with {','.join(COLUMNS)}"


@dataclasses.dataclass(frozen=True)
class Points:
    """What a file holds."""

    position: np.ndarray
    """(n, 3) [m]."""
    rotation: Rotation | None
    """None: the file says nothing about it."""


def read_points(path: Path) -> Points:
    """Points of a file; `make_path` says what it must hold.

    Raises:
        ConfigError: one line that names the file and what is wrong in it.
    """
    position, turn = (_read_csv if path.suffix == ".csv" else _read_npz)(path)
    if len(position) < 2:
        raise ConfigError(f"{path}: holds {len(position)} points, allowed: at least 2")
    for values in (position, turn):
        if values is not None and not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values).all(axis=1)))
            raise ConfigError(f"{path}: got a value that is not finite in point {row} (the first is 0)")
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


def read_cells(path: Path) -> list[list[str]]:
    """Rows of a CSV, empty lines left out.

    Raises:
        ConfigError: one line that names the file.
    """
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            return [[cell.strip() for cell in row] for row in csv.reader(file) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error


def numbers_of(path: Path, rows: list[list[str]], width: int) -> np.ndarray:
    """Cells as numbers (n, width).

    Raises:
        ConfigError: a row of another width, or a cell that is no number.
    """
    try:
        return np.array([[float(cell) for cell in row] for row in rows]).reshape(-1, width)
    except ValueError as error:
        raise ConfigError(f"{path}: a row does not hold {width} numbers ({error})") from error


def _read_csv(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    rows = read_cells(path)
    header = rows[0] if rows else []
    turns = [names for names in ([], QUATERNION, COLUMNS) if sorted(header) == sorted(POSITION + names)]
    if not turns:
        raise ConfigError(f"{path}: has the columns {','.join(header) or 'of no header'}, allowed: {ALLOWED_COLUMNS}")
    values = numbers_of(path, rows[1:], len(header))
    places = [header.index(name) for name in POSITION + turns[0]]
    return values[:, places[:3]], values[:, places[3:]] if turns[0] else None


def _read_npz(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    try:
        arrays = artifacts.load(path)
    except ArtifactError as error:
        raise ConfigError(str(error)) from error
    shapes = {name: array.shape[1:] for name, array in arrays.items()}
    if shapes.get("pose") in ((9,), (3,)):
        pose = np.asarray(arrays["pose"], np.float64)
        return pose[:, :3], pose[:, 3:] if pose.shape[1] == 9 else None
    if shapes.get("position") != (3,) or shapes.get("quaternion", (4,)) != (4,):
        found = ", ".join(f"{name} {array.shape}" for name, array in arrays.items()) or "nothing"
        raise ConfigError(
            f"{path}: holds {found}, allowed: position (n, 3) with or without quaternion (n, 4), or pose (n, 9)"
        )
    turn = arrays.get("quaternion")
    if turn is not None and len(turn) != len(arrays["position"]):
        raise ConfigError(
            f"{path}: holds {len(arrays['position'])} positions and {len(turn)} quaternions, allowed: as many"
        )
    return np.asarray(arrays["position"], np.float64), None if turn is None else np.asarray(turn, np.float64)


def _rotations(path: Path, turn: np.ndarray) -> Rotation:
    """Rotations of quaternions (n, 4), w first, or of two columns (n, 6)."""
    if turn.shape[1] == 4:
        size = np.abs(np.linalg.norm(turn, axis=1) - 1.0)
        _refuse_rows(path, size > 1e-3, "is no unit quaternion")
        return Rotation.from_quat(turn, scalar_first=True)
    x, y = turn[:, :3], turn[:, 3:]
    gram = np.stack([np.sum(a * b, axis=1) for a, b in itertools.combinations_with_replacement((x, y), 2)], axis=1)
    _refuse_rows(
        path, np.abs(gram - [1.0, 0.0, 1.0]).max(axis=1) > 1e-3, "is no rotation: its columns are not orthonormal"
    )
    return Rotation.from_matrix(np.stack([x, y, np.cross(x, y)], axis=2))


def _refuse_rows(path: Path, is_bad: np.ndarray, what: str) -> None:
    if is_bad.any():
        raise ConfigError(f"{path}: point {int(np.argmax(is_bad))} (the first is 0) {what} to 1e-3")
