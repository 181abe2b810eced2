"""Poses to look at the strands in: all over the workspace, single segments bent alone, or the rows of a path."""

import math
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from scipy.stats import qmc

from qjrl import artifacts
from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError
from qjrl.robot import bends_from_angles, bends_from_cables, cable_lengths, forward_kinematics
from qjrl.robot.quaternion_arm.sampling import bends_from_unit_cube
from qjrl.robot.verbs import Robot
from qjrl.simulation.row_by_row import row_by_row
from qjrl.solvers import solve_least_squares

Law = Literal["even", "uniform"]
LAWS: tuple[Law, ...] = ("even", "uniform")


@struct.dataclass
class PoseSet:
    """Commands and what the closed form makes of them, one row a pose."""

    cable_lengths: np.ndarray
    """(n, cables) [m] relative to home, + pays out."""
    bends: np.ndarray
    """(n, segments, 2)."""
    nominal_pose: np.ndarray
    """(n, 9) [m, -]."""

    def __len__(self) -> int:
        return len(self.cable_lengths)


def workspace_poses(robot: Robot, law: Law, count: int, seed: int, rim_share: float = 0.0) -> PoseSet:
    """`count` points of one scrambled Sobol sequence; its first half is the set of half the size.

    Args:
        law: "even" over each segment's disc of bends, as data sets are; "uniform" in angle up to the limit and in
            direction, the paper's law of test poses (section 5.2).
        rim_share: of the poses, all segments of which are bent to the limit.
    """
    drawn = qmc.Sobol(2 * robot.num_segments + 1, rng=seed).random(2 ** math.ceil(math.log2(max(count, 1))))[:count]
    drawn[drawn[:, -1] < rim_share, 0:-1:2] = 1.0  # both laws read radius, turn, radius, turn, ...
    bends = row_by_row({"even": bends_from_unit_cube, "uniform": _uniform}[law], robot, drawn[:, :-1])
    return _of_bends(robot, bends)


def single_segment_poses(robot: Robot, num_angles: int, num_directions: int) -> PoseSet:
    """Each segment bent alone, (segments * num_angles * num_directions) poses in that order of axes: angles rise evenly to
    the limit, directions go once around."""
    angle = float(robot.bend_limit) * np.arange(1, num_angles + 1) / num_angles
    direction = 2.0 * np.pi * np.arange(num_directions) / num_directions
    one = np.asarray(bends_from_angles(jnp.asarray(np.tile(direction, num_angles)), jnp.repeat(angle, num_directions)))
    bends = np.zeros((robot.num_segments, len(one), robot.num_segments, 2))
    for segment in range(robot.num_segments):
        bends[segment, :, segment] = one
    return _of_bends(robot, bends.reshape(-1, robot.num_segments, 2))


def path_poses(robot: Robot, path: Path, count: int) -> PoseSet:
    """At most `count` rows of a path, evenly apart, first and last among them.

    Args:
        path: `.npz` with `cable_lengths` (n, cables) [m], as a tracked trajectory holds them, or else `pose` (n, 9); or
            `.csv` with one column a cable [m], in the order of the description, or nine of a pose, with or without a line
            of names. Poses are inverted by least squares on the closed form.
    Raises:
        ConfigError: missing file, other columns, non-finite values, or a pose that the arm does not reach.
    """
    rows = _read(robot, path)
    chosen = rows[np.unique(np.linspace(0, len(rows) - 1, min(count, len(rows))).round().astype(int))]
    if chosen.shape[1] == robot.num_cables:
        return _of_lengths(robot, chosen)
    answer = solve_least_squares(robot, chosen, np.zeros((robot.num_segments, 2)))
    reached = np.asarray(answer.converged)
    if not reached.all():
        worst = int(np.argmax(np.asarray(answer.position_error)))
        raise ConfigError(
            f"pretension.path: {path} holds {np.sum(~reached)} poses that the closed form does not reach, the worst is "
            f"{1e3 * float(answer.position_error[worst]):.1f} mm off: {chosen[worst, :3].round(4).tolist()} m"
        )
    return _of_lengths(robot, np.asarray(answer.cable_lengths, np.float64))


def _read(robot: Robot, path: Path) -> np.ndarray:
    """Rows of cable lengths (n, cables) or poses (n, 9)."""
    if path.suffix == ".npz":
        try:
            arrays = artifacts.load(path)
        except ArtifactError as error:
            raise ConfigError(f"pretension.path: {error}") from error
        rows = next((arrays[name] for name in ("cable_lengths", "pose") if name in arrays), np.zeros((0, 0)))
    else:
        rows = _read_csv(path)
    if rows.ndim != 2 or len(rows) == 0 or rows.shape[1] not in (robot.num_cables, 9):
        raise ConfigError(
            f"pretension.path: {path} holds rows of shape {rows.shape}, allowed: (n, {robot.num_cables}) cable lengths "
            "or (n, 9) poses, in a .npz under the names cable_lengths or pose"
        )
    if not np.isfinite(rows).all():
        raise ConfigError(f"pretension.path: {path} holds a value that is not finite at row {_first_bad(rows)}")
    return np.asarray(rows, np.float64)


def _read_csv(path: Path) -> np.ndarray:
    """Numbers of a CSV, its first line left out if it holds names."""
    try:
        first = path.read_text(encoding="utf-8").partition("\n")[0]
        return np.loadtxt(path, delimiter=",", skiprows=int(not _is_number(first.split(",")[0])), ndmin=2)
    except (OSError, ValueError) as error:
        raise ConfigError(f"pretension.path: {path}: {' '.join(str(error).split())}") from error


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _first_bad(rows: np.ndarray) -> int:
    return int(np.argmax(~np.isfinite(rows).all(axis=1)))


def _of_bends(robot: Robot, bends: np.ndarray) -> PoseSet:
    lengths, pose = row_by_row(_lengths_and_pose, robot, bends)
    return PoseSet(np.asarray(lengths, np.float64), np.asarray(bends), np.asarray(pose))


def _of_lengths(robot: Robot, lengths: np.ndarray) -> PoseSet:
    bends, pose = row_by_row(_bends_and_pose, robot, lengths)
    return PoseSet(lengths, np.asarray(bends), np.asarray(pose))


def _uniform(robot: Robot, numbers: jax.Array) -> jax.Array:
    share, turn = numbers.reshape(robot.num_segments, 2).T
    return bends_from_angles(2 * jnp.pi * turn, robot.bend_limit * share)


def _lengths_and_pose(robot: Robot, bends: jax.Array) -> tuple[jax.Array, jax.Array]:
    return cable_lengths(robot, bends), forward_kinematics(robot, bends)


def _bends_and_pose(robot: Robot, lengths: jax.Array) -> tuple[jax.Array, jax.Array]:
    bends = bends_from_cables(robot, lengths)
    return bends, forward_kinematics(robot, bends)
