"""Targets that an arm can reach in the physics: where commands of another seed came to rest, apart from the training rows."""

import numpy as np
from scipy.spatial import KDTree

from qjrl.config import ConfigError
from qjrl.keys import seed_for
from qjrl.robot.verbs import Robot
from qjrl.simulation.rested import require_rest
from qjrl.simulation.sampling import sample_rows
from qjrl.simulation.settle_problem import SettleConfig

# Rows settled at once.
_CHUNK = 512
# After so many rows a smaller share of them that are targets means that there are none to speak of.
_PATIENCE, _SMALLEST_SHARE = 4096, 0.01


def reachable_targets(
    robot: Robot, simulation: SettleConfig, trained: np.ndarray, count: int, distance: float, seed: int, advance=None
) -> np.ndarray:
    """Settled poses (count, 9) whose tips lie at least `distance` [m] from the tip of every pose trained on.

    Args:
        trained: (rows, 9) poses of the data set.
        advance: called with the number of newly found targets.
    Raises:
        ConfigError: hardly any pose lies so far from all rows, or none rests.
    """
    tree, found, missing, start = KDTree(trained[:, :3]), [], count, 0
    while missing > 0:
        if start >= _PATIENCE and count - missing < _SMALLEST_SHARE * start:
            raise ConfigError(
                f"accuracy.distance: got {distance:g}, allowed: less; {count - missing} of {start} settled poses lie so far "
                f"from the {len(trained)} rows of the data set"
            )
        rows = sample_rows(robot, simulation, seed_for(seed, "reachable targets"), start, _CHUNK)
        require_rest(rows["converged"], "accuracy: commands that targets are made of")
        poses = rows["pose"][rows["converged"]]
        new = poses[tree.query(poses[:, :3])[0] >= distance][:missing]
        found.append(new)
        missing, start = missing - len(new), start + _CHUNK
        if advance:
            advance(len(new))
    return np.concatenate(found)
