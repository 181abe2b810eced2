"""`contract.json`: all that a controller must know of the files beside it, so that it needs nothing else."""

from collections.abc import Iterable, Mapping
from typing import Any

from qjrl.config import as_mapping
from qjrl.deployment.functions import POSE_NAMES, DeployedFunction, Port, Precision
from qjrl.robot.interface import quantity
from qjrl.robot.kinds import verb
from qjrl.robot.loading import robot_hash
from qjrl.robot.plausibility import FARTHEST_TARGET
from qjrl.robot.verbs import Robot

FORMAT = 1


def robot_contract(robot: Robot) -> dict[str, Any]:
    """Names, order, units, limits, motors and homing of one robot."""
    own = verb(robot, "interface").contract(robot)
    about = {"name": robot.name, "kind": robot.kind, "hash": robot_hash(robot), "description": as_mapping(robot.config)}
    return own | {
        "robot": about | own["robot"],
        "conventions": CONVENTIONS | own["conventions"],
        "pose_names": list(POSE_NAMES),
        "targets": _targets(robot),
    }


def function_contract(deployed: DeployedFunction, precision: Precision, files: Mapping[str, Any]) -> dict[str, Any]:
    """What goes in and out of one function, and the files that hold it."""
    return {
        "files": dict(files),
        "batch": "every array has a leading batch axis of any size",
        "inputs": _ports(deployed.inputs, precision),
        "outputs": _ports(deployed.outputs, precision),
    }


def _ports(ports: Iterable[Port], precision: Precision) -> list[dict[str, Any]]:
    return [
        {
            "name": port.name,
            "shape": ["batch", *port.shape],
            "dtype": port.dtype or precision,
            "unit": port.unit,
            "meaning": port.meaning,
        }
        for port in ports
    ]


def _targets(robot: Robot) -> dict[str, Any]:
    return {
        "meaning": "position in m, two orthonormal columns of the rotation; what is out of reach gets the nearest pose",
        "length_of_the_arm": quantity(verb(robot, "reach")(robot), "m"),
        "largest_distance": quantity(FARTHEST_TARGET * verb(robot, "reach")(robot), "m"),
        "rule": "a position farther from the base than largest_distance is in another unit: refuse it",
    }


CONVENTIONS = {
    "units": "SI: m, rad, s, N; a name that ends in _deg is in degrees",
    "pose": "position of the tip, then the first and the second column of its rotation; the third is their cross product",
    "quasi_static": "the forward model predicts the pose at rest",
}
