"""The kinds of robots: one record each. A kind is a folder; here it is entered by the name that its YAML gives."""

import math
from typing import Any

from qjrl.config import ConfigError
from qjrl.field_words import show
from qjrl.robot.continuum_arm.kind import CONTINUUM_ARM
from qjrl.robot.kind import Kind, Robot
from qjrl.robot.quaternion_arm.kind import QUATERNION_ARM

KINDS: dict[str, Kind] = {"quaternion_arm": QUATERNION_ARM, "continuum_arm": CONTINUUM_ARM}


def require_robot(robot: Any) -> None:
    """Raises a ConfigError where something else, such as a name, stands for a robot."""
    if not isinstance(robot, Robot):
        raise ConfigError(f"robot: got {show(robot)}, allowed: what load_robot returns")


def kind_of(robot: Robot) -> Kind:
    """The record of a robot's kind.

    Raises:
        ConfigError: it is no robot.
    """
    require_robot(robot)
    return KINDS[robot.kind]


def verb(robot: Robot, name: str) -> Any:
    """The function of a robot's kind.

    Raises:
        ConfigError: it is no robot, or its kind does not offer the function.
    """
    function = getattr(kind := kind_of(robot), name)
    if function is None:
        raise ConfigError(f"robot kind {robot.kind}: offers no {name}, it offers {', '.join(kind.offers())}")
    return function


def configuration_shape(robot: Robot) -> tuple[int, ...]:
    """Shape of the robot's configuration."""
    return kind_of(robot).shape_of(robot)


def num_coordinates(robot: Robot) -> int:
    """How many numbers a configuration of the robot has."""
    return math.prod(configuration_shape(robot))
