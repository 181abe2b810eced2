"""The arms that the tests run on, and random configurations of them."""

import copy
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import conf_folder, read_yaml
from qjrl.robot import bends_from_angles, load_robot, robot_from_mapping
from qjrl.robot.quaternion_arm.arm import QuaternionArm, require_arm
from qjrl.robot.verbs import Robot

SHIPPED = sorted(
    path.stem for path in (conf_folder() / "robot").glob("*.yaml") if read_yaml(path)["kind"] == "quaternion_arm"
)
MADE_UP = ["rolling_312", "spherical_312"]
ARMS = [*SHIPPED, *MADE_UP]


def arm_named(name: str) -> QuaternionArm:
    """A shipped arm, or one of three segments with oblique hole pairs, a payload and tensioners."""
    return arm_of(made_up_mapping(name)) if name in MADE_UP else require_arm(load_robot(name), "a test")


def arm_of(mapping: dict[str, Any]) -> QuaternionArm:
    """The arm of a description."""
    return require_arm(robot_from_mapping(mapping), "a test")


def made_up_mapping(name: str) -> dict[str, Any]:
    is_rolling = name.startswith("rolling")
    pins = {"crossed_link_length": 0.03606, "pin_distance": 0.020, "plate_to_pin": 0.001}
    flat = {"crossed_link_length": 0.034, "pin_distance": 0.0, "plate_to_pin": 0.0}
    mapping: dict[str, Any] = altered("qj_2222", joints_per_segment=[3, 1, 2], link_length=0.021)
    mapping["name"] = name
    mapping["joint"] |= pins if is_rolling else flat
    mapping["cables"] |= {"hole_angles_deg": [[0, 70], [20, 100], [45, 150]], "names": [[1, 2], [3, 4], [5, 6]]}
    mapping["mechanics"] |= {"payload": 0.05}
    mapping["strands"] |= {"tensioner_stiffness": 60000.0}
    return mapping


def altered(base: str, **changes: Any) -> dict[str, Any]:
    """The YAML of a shipped arm with values replaced; keys of a part as `joint__pin_distance`."""
    mapping = copy.deepcopy(read_yaml(conf_folder() / "robot" / f"{base}.yaml"))
    for key, value in changes.items():
        part, _, field = key.partition("__")
        if field:
            mapping[part][field] = value
        else:
            mapping[part] = value
    return mapping


def random_bends(arm: Robot, count: int, seed: int = 0, share: float = 1.0) -> np.ndarray:
    """Bends (count, segments, 2): directions uniform, angles uniform up to `share` of the limit."""
    random = np.random.default_rng(seed)
    directions = random.uniform(0.0, 2.0 * np.pi, (count, arm.num_segments))
    angles = random.uniform(0.0, share * float(arm.bend_limit), (count, arm.num_segments))
    return np.asarray(bends_from_angles(jnp.asarray(directions), jnp.asarray(angles)))


def over_rows(function, arm: Robot, rows) -> np.ndarray:
    """`function(arm, row)` for every row."""
    return np.asarray(jax.jit(jax.vmap(lambda row: function(arm, row)))(jnp.asarray(rows)))


def joint_matrix(arm: Robot, bend) -> np.ndarray:
    """Paper 000, Eq. 2 (off-diagonal corrected) with the rolling height, in numpy: (4, 4) from the lower to the upper plate."""
    joint = arm.config.joint
    direction, angle = np.arctan2(bend[1], bend[0]), 2.0 * np.arcsin(np.hypot(*bend))
    c, s, half, cosine = np.cos(direction), np.sin(direction), np.sin(angle / 2.0), np.cos(angle / 2.0)
    height = (
        np.sqrt(joint.crossed_link_length**2 - (joint.pin_distance * cosine) ** 2) + 2.0 * joint.plate_to_pin * cosine
    )
    mixed = -np.sin(2.0 * direction) * half**2
    return np.array(
        [
            [1 - 2 * c**2 * half**2, mixed, c * np.sin(angle), height * c * half],
            [mixed, 1 - 2 * s**2 * half**2, s * np.sin(angle), height * s * half],
            [-c * np.sin(angle), -s * np.sin(angle), np.cos(angle), height * cosine],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
