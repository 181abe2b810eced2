"""What each kind of robot offers: its own functions behind the common verbs."""

from collections.abc import Callable
from typing import Any

from qjrl.config import ConfigError
from qjrl.field_words import show
from qjrl.robot.quaternion_arm import cables, coordinates, kinematics, mjcf, statics
from qjrl.robot.quaternion_arm.description import QuaternionArm

Robot = QuaternionArm  # a union once there is a second kind

VERBS: dict[str, dict[str, Callable[..., Any]]] = {
    "quaternion_arm": {
        "forward_kinematics": kinematics.forward_kinematics,
        "cable_lengths": cables.cable_lengths,
        "bends_from_cables": cables.bends_from_cables,
        "cable_strokes": cables.cable_strokes,
        "strand_lengths": cables.strand_lengths,
        "strand_commands": cables.strand_commands,
        "equilibrium": statics.equilibrium,
        "strand_tension": statics.strand_tension,
        "is_at_strength": statics.is_at_strength,
        "joint_positions": coordinates.joint_positions,
        "configuration_from_joint_positions": coordinates.bends_from_joint_positions,
        "build_mjcf": mjcf.build_mjcf,
    },
}


def require_robot(robot: Any) -> None:
    """Raises a ConfigError where something else, such as a name, stands for a robot."""
    if not isinstance(robot, Robot):
        raise ConfigError(f"robot: got {show(robot)}, allowed: what load_robot returns")


def verb(robot: Robot, name: str) -> Callable[..., Any]:
    """The function of a robot's kind.

    Raises:
        ConfigError: it is no robot.
        ValueError: the kind does not offer it.
    """
    require_robot(robot)
    if name not in VERBS[robot.kind]:
        raise ValueError(f"robot kind {robot.kind}: offers no {name}, it offers {', '.join(VERBS[robot.kind])}")
    return VERBS[robot.kind][name]
