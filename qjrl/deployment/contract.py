"""`contract.json`: all that a controller must know of the files beside it, so that it needs nothing else."""

from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import as_mapping
from qjrl.deployment.functions import POSE_NAMES, DeployedFunction, Port, Precision
from qjrl.deployment.safety import reading_limits
from qjrl.robot.kinds import verb
from qjrl.robot.loading import robot_hash
from qjrl.robot.plausibility import FARTHEST_TARGET
from qjrl.robot.verbs import Robot, bends_from_cables, cable_strokes

FORMAT = 1


def robot_contract(robot: Robot) -> dict[str, Any]:
    """Names, order, units, limits, motors and homing of one robot."""
    return {
        "robot": {
            "name": robot.name,
            "kind": robot.kind,
            "joint_model": robot.joint_model,
            "hash": robot_hash(robot),
            "description": as_mapping(robot.config),
        },
        "conventions": CONVENTIONS,
        "pose_names": list(POSE_NAMES),
        "cables": _cables(robot),
        "bends": _bends(robot),
        "motors": _motors(robot),
        "readings": _readings(robot),
        "targets": _targets(robot),
        "homing": HOMING | {"pretension": _quantity(robot.pretension, "N")},
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


def _cables(robot: Robot) -> list[dict[str, Any]]:
    """In the order of `cable_lengths`; a length within its range may still ask too much of a joint, see `bends`."""
    names = [name for pair in robot.config.cables.names for name in pair]
    angles = [angle for pair in robot.config.cables.hole_angles_deg for angle in pair]
    strokes = np.asarray(cable_strokes(robot)).tolist()
    return [
        {
            "index": index,
            "name": name,
            "segment": index // 2 + 1,
            "hole_angle_deg": angle,
            "low": -stroke,
            "high": stroke,
            "unit": "m",
        }
        for index, (name, angle, stroke) in enumerate(zip(names, angles, strokes, strict=True))
    ]


def _bends(robot: Robot) -> dict[str, Any]:
    """The limits of the joints as a linear map and a radius, so that a command can be checked without the package."""
    matrix = jax.jacfwd(lambda row: bends_from_cables(robot, row).reshape(-1))(jnp.zeros(robot.num_cables))
    return {
        "meaning": "a_k = sin(theta_k / 2) (cos phi_k, sin phi_k) of segment k; bends = from_cable_lengths @ cable_lengths",
        "order": [f"a_{k + 1}_{axis}" for k in range(robot.num_segments) for axis in "xy"],
        "from_cable_lengths": np.asarray(matrix).tolist(),
        "limit": float(jnp.sin(robot.bend_limit / 2.0)),
        "rule": "a command is allowed when the norm of every a_k is at most limit",
        "angle_limit": _quantity(robot.bend_limit, "rad"),
        "joints_per_segment": list(robot.joints_per_segment),
    }


def _motors(robot: Robot) -> dict[str, Any]:
    radius = robot.config.motors.pulley_radius
    return {
        "count": robot.num_cables,
        "order": "as cables",
        "pulley_radius": _quantity(radius, "m"),
        "angle_per_length": _quantity(1.0 / radius, "rad/m"),
        "sign": "a positive length and motor angle pays out the strand at the hole angle and takes in the opposite one",
        "largest_speed": _quantity(robot.motor_speed, "m/s"),
        "largest_angular_speed": _quantity(robot.motor_speed / radius, "rad/s"),
        "largest_force": _quantity(robot.motor_force, "N"),
        "largest_torque": _quantity(robot.motor_force * radius, "N m"),
        "force": "difference of the tensions of a loop's two strands",
        "strand_strength": _quantity(robot.config.strands.strength, "N"),
    }


def _readings(robot: Robot) -> dict[str, Any]:
    limits = reading_limits(robot)
    return {
        "meaning": "each segment's bend theta (cos phi, sin phi); a reading outside these limits is no sound encoder's",
        "largest_angle": _quantity(limits.angle, "rad"),
        "largest_speed": _quantity(limits.speed, "rad/s"),
        "largest_jump": _quantity(limits.jump, "rad"),
        "rule": "the norm of every segment's reading is at most largest_angle, and that of its difference from the last good "
        "reading at most largest_jump + largest_speed * the time since",
    }


def _targets(robot: Robot) -> dict[str, Any]:
    return {
        "meaning": "position in m, two orthonormal columns of the rotation; what is out of reach gets the nearest pose",
        "length_of_the_arm": _quantity(verb(robot, "reach")(robot), "m"),
        "largest_distance": _quantity(FARTHEST_TARGET * verb(robot, "reach")(robot), "m"),
        "rule": "a position farther from the base than largest_distance is in another unit: refuse it",
    }


def _quantity(value: Any, unit: str) -> dict[str, Any]:
    return {"value": float(value), "unit": unit}


CONVENTIONS = {
    "units": "SI: m, rad, s, N; a name that ends in _deg is in degrees",
    "frame": "base frame; z along the straight arm, from the base to the tip; hole angles count from x towards y",
    "pose": "position of the tip, then the first and the second column of its rotation; the third is their cross product",
    "cable_lengths": "one a loop of two strands, relative to home; half the difference of the two strands' lengths",
    "quasi_static": "the forward model predicts the pose at rest",
}

HOMING = {
    "meaning": "all cable lengths and motor angles are zero where the arm is straight and every strand has the pretension",
    "steps": [
        "straighten the arm along z",
        "tighten both strands of every loop to the pretension",
        "set every motor angle to zero",
    ],
}
