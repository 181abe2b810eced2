"""Targets that an arm can reach in the physics: where commands of another seed came to rest, apart from the training rows."""

import numpy as np
from scipy.spatial import KDTree

from qjrl.robot.verbs import Robot
from qjrl.simulation.sampling import sample_rows
from qjrl.simulation.settle_problem import SettleConfig

# Offset of the run's seed: commands that no data set of the run has.
_SEED = 7_000_003
# Rows settled at once.
_CHUNK = 512


def reachable_targets(
    robot: Robot, simulation: SettleConfig, trained: np.ndarray, count: int, distance: float, seed: int, advance=None
) -> np.ndarray:
    """Settled poses (count, 9) whose tips lie at least `distance` [m] from the tip of every pose trained on.

    Args:
        trained: (rows, 9) poses of the data set.
        advance: called with the number of newly found targets.
    """
    tree, found, start = KDTree(trained[:, :3]), [], 0
    while sum(len(poses) for poses in found) < count:
        rows = sample_rows(robot, simulation, seed + _SEED, start, _CHUNK)
        poses = rows["pose"][rows["converged"]]
        new = poses[tree.query(poses[:, :3])[0] >= distance]
        found.append(new)
        start += _CHUNK
        if advance:
            advance(min(len(new), count - sum(len(one) for one in found[:-1])))
    return np.concatenate(found)[:count]
