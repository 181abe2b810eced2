"""Poses to look at the strands in: all over the workspace, or single segments bent alone."""

import math
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from scipy.stats import qmc

from qjrl.robot import bends_from_angles, cable_lengths, forward_kinematics
from qjrl.robot.kinds import verb
from qjrl.robot.verbs import Robot
from qjrl.simulation.row_by_row import row_by_row

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
    bends = row_by_row({"even": verb(robot, "from_unit_cube"), "uniform": _uniform}[law], robot, drawn[:, :-1])
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


def _of_bends(robot: Robot, bends: np.ndarray) -> PoseSet:
    lengths, pose = row_by_row(_lengths_and_pose, robot, bends)
    return PoseSet(np.asarray(lengths, np.float64), np.asarray(bends), np.asarray(pose))


def _uniform(robot: Robot, numbers: jax.Array) -> jax.Array:
    share, turn = numbers.reshape(robot.num_segments, 2).T
    return bends_from_angles(2 * jnp.pi * turn, robot.bend_limit * share)


def _lengths_and_pose(robot: Robot, bends: jax.Array) -> tuple[jax.Array, jax.Array]:
    return cable_lengths(robot, bends), forward_kinematics(robot, bends)
