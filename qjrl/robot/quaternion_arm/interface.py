"""What controllers outside the package must know of this arm: cables, bends, motors, readings, homing."""

import itertools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.robot.interface import ANGLE_MARGIN, Interface, ReadingLimits, quantity
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.cables import bends_from_cables, cable_strokes
from qjrl.robot.quaternion_arm.naming import cable_numbers

# A joint springs and swings, which the motors do not.
_SPEED_FACTOR = 3.0
_CONVENTIONS = {
    "frame": "base frame; z along the straight arm, from the base to the tip; hole angles count from x towards y",
    "cable_lengths": "one a loop of two strands, relative to home; half the difference of the two strands' lengths",
}
_HOMING = {
    "meaning": "all cable lengths and motor angles are zero where the arm is straight and every strand has the pretension",
    "steps": [
        "straighten the arm along z",
        "tighten both strands of every loop to the pretension",
        "set every motor angle to zero",
    ],
}


def contract(arm: QuaternionArm) -> dict[str, Any]:
    """Names, order, units, limits, motors and homing."""
    return {
        "robot": {"joint_model": arm.joint_model},
        "conventions": _CONVENTIONS,
        "cables": _cables(arm),
        "bends": _bends(arm),
        "motors": _motors(arm),
        "readings": _readings(arm),
        "homing": _HOMING | {"pretension": quantity(arm.pretension, "N")},
    }


def reading_limits(arm: QuaternionArm) -> ReadingLimits:
    """The stop of the arm's joints, and the rate at which its motors, all at their speed, can bend one at that stop."""
    stop = float(arm.stop)
    by_length = np.asarray(jax.jacfwd(lambda row: bends_from_cables(arm, row))(jnp.zeros(arm.num_cables)))
    fastest = max(_fastest(rows) for rows in by_length) * float(arm.motor_speed)
    # theta = 2 asin|a|: at the stop it changes most with a
    speed = 2.0 * fastest / math.cos(stop / 2.0)
    return ReadingLimits(stop + ANGLE_MARGIN, _SPEED_FACTOR * speed, ANGLE_MARGIN)


def pulley_radius(arm: QuaternionArm) -> float:
    """[m/rad]."""
    return float(arm.pulley_radius)


def _fastest(rows: np.ndarray) -> float:
    """Largest length of rows (2, cables) times cable speeds of -1 or 1: at a corner of their cube, as the length is convex."""
    moved = rows[:, np.abs(rows).max(axis=0) > 0.0]
    return max(float(np.linalg.norm(moved @ signs)) for signs in itertools.product((-1.0, 1.0), repeat=moved.shape[1]))


def _cables(arm: QuaternionArm) -> list[dict[str, Any]]:
    """In the order of `cable_lengths`; a length within its range may still ask too much of a joint, see `bends`."""
    angles = [angle for pair in arm.config.cables.hole_angles_deg for angle in pair]
    strokes = np.asarray(cable_strokes(arm)).tolist()
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
        for index, (name, angle, stroke) in enumerate(zip(cable_numbers(arm), angles, strokes, strict=True))
    ]


def _bends(arm: QuaternionArm) -> dict[str, Any]:
    """The limits of the joints as a linear map and a radius, so that a command can be checked without the package."""
    matrix = jax.jacfwd(lambda row: bends_from_cables(arm, row).reshape(-1))(jnp.zeros(arm.num_cables))
    return {
        "meaning": "a_k = sin(theta_k / 2) (cos phi_k, sin phi_k) of segment k; bends = from_cable_lengths @ cable_lengths",
        "order": [f"a_{k + 1}_{axis}" for k in range(arm.num_segments) for axis in "xy"],
        "from_cable_lengths": np.asarray(matrix).tolist(),
        "limit": float(jnp.sin(arm.bend_limit / 2.0)),
        "rule": "a command is allowed when the norm of every a_k is at most limit",
        "angle_limit": quantity(arm.bend_limit, "rad"),
        "joints_per_segment": list(arm.joints_per_segment),
    }


def _motors(arm: QuaternionArm) -> dict[str, Any]:
    radius = pulley_radius(arm)
    return {
        "count": arm.num_cables,
        "order": "as cables",
        "pulley_radius": quantity(radius, "m"),
        "angle_per_length": quantity(1.0 / radius, "rad/m"),
        "sign": "a positive length and motor angle pays out the strand at the hole angle and takes in the opposite one",
        "largest_speed": quantity(arm.motor_speed, "m/s"),
        "largest_angular_speed": quantity(arm.motor_speed / radius, "rad/s"),
        "largest_force": quantity(arm.motor_force, "N"),
        "largest_torque": quantity(arm.motor_force * radius, "N m"),
        "force": "difference of the tensions of a loop's two strands",
        "strand_strength": quantity(arm.strand_strength, "N"),
    }


def _readings(arm: QuaternionArm) -> dict[str, Any]:
    limits = reading_limits(arm)
    return {
        "meaning": "each segment's bend theta (cos phi, sin phi); a reading outside these limits is no sound encoder's",
        "largest_angle": quantity(limits.angle, "rad"),
        "largest_speed": quantity(limits.speed, "rad/s"),
        "largest_jump": quantity(limits.jump, "rad"),
        "rule": "the norm of every segment's reading is at most largest_angle, and that of its difference from the last good "
        "reading at most largest_jump + largest_speed * the time since",
    }


INTERFACE = Interface(contract, reading_limits, pulley_radius)
