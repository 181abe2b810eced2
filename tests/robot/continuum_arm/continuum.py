"""Continuum arms for the tests: the shipped one, and one with unlike segments of five cables."""

import copy
from typing import Any

import jax
import numpy as np

from qjrl.config import conf_folder, read_yaml
from qjrl.robot import robot_from_mapping
from qjrl.robot.continuum_arm.arm import ContinuumArm
from qjrl.robot.continuum_arm.sampling import uniform_bends


def mapping(**changes: Any) -> dict[str, Any]:
    """The YAML of the shipped arm with values replaced: `segments__lengths=[...]`."""
    content = copy.deepcopy(read_yaml(conf_folder() / "robot" / "continuum_4.yaml"))
    for key, value in changes.items():
        part, _, field = key.partition("__")
        if field:
            content[part][field] = value
        else:
            content[part] = value
    return content


def arm(**changes: Any) -> ContinuumArm:
    """The arm of `mapping`."""
    robot = robot_from_mapping(mapping(**changes))
    assert isinstance(robot, ContinuumArm)
    return robot


def unlike() -> ContinuumArm:
    """Three segments of other lengths and radii, five cables each at uneven azimuths."""
    return arm(
        name="unlike",
        segments__lengths=[0.2, 0.1, 0.05],
        segments__anchor_radii=[0.05, 0.03, 0.02],
        cables__anchor_angles_deg=[[0, 70, 140, 210, 290], [10, 100, 170, 250, 300], [5, 77, 149, 221, 293]],
        cables__names=[[1, 2, 3, 4, 5], [6, 7, 8, 9, 10], [11, 12, 13, 14, 15]],
    )


def random_bends(robot: ContinuumArm, count: int, seed: int = 0) -> np.ndarray:
    """Bends (count, segments, 2) within the limits [rad]."""
    keys = jax.random.split(jax.random.key(seed), count)
    return np.asarray(jax.vmap(lambda key: uniform_bends(robot, key))(keys))
