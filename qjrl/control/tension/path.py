"""Places along a path to look at the strands in: rows of cable lengths as a file holds them, or poses as `track` runs them."""

from pathlib import Path

import jax
import numpy as np

from qjrl import artifacts
from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError
from qjrl.control.tension.poses import PoseSet
from qjrl.control.tracking.files import ALLOWED_COLUMNS, FILE_KINDS, POSITION, numbers_of, read_cells
from qjrl.control.tracking.inversion import PathInversionConfig, invert_path
from qjrl.control.tracking.paths import PosePath, ShapeConfig, make_path
from qjrl.robot import bends_from_cables, forward_kinematics
from qjrl.robot.verbs import Robot
from qjrl.simulation.row_by_row import row_by_row

_KEY = "pretension.path"


def path_poses(robot: Robot, source: str, count: int, seed: int = 0) -> PoseSet:
    """At most `count` places along a path, evenly apart, first and last among them.

    Poses are inverted on the closed form by the stage `track`'s inversion at its defaults, along the smooth curve through
    them; where a file holds positions alone, orientation is free.

    Args:
        source: as `read_path`.
        seed: of the inversion's first guesses.
    Raises:
        ConfigError: as `read_path`, or a path that the arm does not reach.
    """
    path = read_path(robot, source)
    if isinstance(path, PosePath):
        cables = invert_path(robot, None, path, PathInversionConfig(), seed)
        path = np.asarray(cables.lengths(path.distance), np.float64)
    return _of_lengths(robot, path[np.unique(np.linspace(0, len(path) - 1, min(count, len(path))).round().astype(int))])


def read_path(robot: Robot, source: str) -> np.ndarray | PosePath:
    """Rows of cable lengths (n, cables) [m], or the path through the poses of a file.

    Args:
        source: `.npz` with `cable_lengths` (n, cables) [m], as a tracked trajectory holds them; `.csv` with one column a
            cable [m], in the order of the description, with or without a line of names; or what `make_path` reads.
    Raises:
        ConfigError: missing file, other columns, non-finite values; one line.
    """
    file = Path(source)
    if file.suffix not in FILE_KINDS:
        raise ConfigError(f"{_KEY}: got '{source}', allowed: a file that ends in {' or '.join(FILE_KINDS)}")
    try:
        rows = (_lengths_of_csv if file.suffix == ".csv" else _lengths_of_npz)(robot, file)
    except (ArtifactError, ConfigError) as error:
        raise ConfigError(f"{_KEY}: {error}") from error
    return make_path(source, ShapeConfig(), _KEY) if rows is None else rows


def _lengths_of_csv(robot: Robot, file: Path) -> np.ndarray | None:
    """None: it holds poses, by its line of names."""
    cells = read_cells(file)
    first = cells[0] if cells else []
    if set(first) & set(POSITION):
        return None
    rows = cells if _is_number(first[:1]) else cells[1:]
    if len(first) != robot.num_cables or not rows:
        raise ConfigError(
            f"{file}: holds {len(rows)} rows of {len(first)} columns, allowed: {robot.num_cables} cable lengths [m], or "
            f"columns named {ALLOWED_COLUMNS}"
        )
    return _finite(file, numbers_of(file, rows, robot.num_cables))


def _lengths_of_npz(robot: Robot, file: Path) -> np.ndarray | None:
    """None: it holds poses, or should."""
    arrays = artifacts.load(file)
    if "cable_lengths" not in arrays and {"position", "pose"} & arrays.keys():
        return None
    rows = arrays.get("cable_lengths", np.zeros((0, 0)))
    if rows.ndim != 2 or len(rows) == 0 or rows.shape[1] != robot.num_cables:
        found = ", ".join(f"{name} {array.shape}" for name, array in arrays.items()) or "nothing"
        raise ConfigError(
            f"{file}: holds {found}, allowed: cable_lengths (n, {robot.num_cables}), or position (n, 3) with or without "
            "quaternion (n, 4), or pose (n, 9)"
        )
    return _finite(file, np.asarray(rows, np.float64))


def _is_number(cells: list[str]) -> bool:
    try:
        return bool([float(cell) for cell in cells])
    except ValueError:
        return False


def _finite(file: Path, rows: np.ndarray) -> np.ndarray:
    is_finite = np.isfinite(rows).all(axis=1)
    if not is_finite.all():
        raise ConfigError(f"{file}: got a value that is not finite in row {int(np.argmin(is_finite))} (the first is 0)")
    return rows


def _of_lengths(robot: Robot, lengths: np.ndarray) -> PoseSet:
    bends, pose = row_by_row(_bends_and_pose, robot, lengths)
    return PoseSet(lengths, np.asarray(bends), np.asarray(pose))


def _bends_and_pose(robot: Robot, lengths: jax.Array) -> tuple[jax.Array, jax.Array]:
    bends = bends_from_cables(robot, lengths)
    return bends, forward_kinematics(robot, bends)
