"""Random valid arms of every size: what others may describe, seeded."""

import math
from typing import Any

import numpy as np
from arms import altered

from qjrl.robot import robot_from_mapping
from qjrl.robot.verbs import Robot

SHIPPED, SHIPPED_CIRCLE = "qj_2222", 0.031
"""The arm that all of them are varied from, and its hole circle [m]."""
MOST_JOINTS = 24
"""Of one arm: longer ones only take longer."""


def random_arm(seed: int) -> Robot:
    """The arm of `random_mapping`."""
    return robot_from_mapping(random_mapping(seed))


def random_mapping(seed: int) -> dict[str, Any]:
    """The YAML of an arm with a hole circle of 10 to 200 mm, 1 to 12 segments and 1 to 6 joints a segment.

    Lengths are the shipped arm's times the circles' ratio, each by up to a fifth longer or shorter. One arm in three keeps
    all else as shipped, as of someone who edits lengths alone. The others have strands for the weight they bear, and the
    second of these two also has masses, joint stiffness, damping and armature for its size. On top of that stiffness,
    strand stiffness, both dampings, armature and pretension lie within a decade each.
    """
    random = np.random.default_rng(seed)
    circle = math.exp(random.uniform(math.log(0.010), math.log(0.200)))
    ratio, law = circle / SHIPPED_CIRCLE, random.integers(3)
    segments = int(random.integers(1, 13))
    counts = random.integers(1, min(6, MOST_JOINTS // segments) + 1, segments)
    mapping = altered(SHIPPED, name=f"random_{seed}", joints_per_segment=counts.tolist())
    mapping["joint"] = _joint(random, ratio)
    mapping["link_length"] = _near(random, 0.030 * ratio)
    mapping["cables"] = _cables(random, segments, circle)
    mechanics, strands = mapping["mechanics"], mapping["strands"]
    mechanics["link_radius"] = _near(random, 0.018 * ratio)
    for name, power in {
        "joint_mass": 3,
        "link_mass": 3,
        "joint_stiffness": 4,
        "joint_damping": 4,
        "armature": 5,
    }.items():
        mechanics[name] *= ratio**power if law == 2 else 1.0
    pull = _pull(mapping) / _pull(altered(SHIPPED)) if law else 1.0
    for name, by in {"stiffness": pull / ratio, "pretension": pull, "damping": pull / ratio}.items():
        strands[name] = _in_decade(random, (by if law else 1.0) * strands[name])
    for name in ("joint_stiffness", "joint_damping", "armature"):
        mechanics[name] = _in_decade(random, mechanics[name])
    strands["strength"] *= max(pull, 1.0)
    mapping["motors"]["force"] *= max(pull, 1.0)
    mechanics["gravity"] = [[0.0, 0.0, -9.81], [0.0, 0.0, 9.81], [9.81, 0.0, 0.0]][random.integers(3)]
    return mapping


def _near(random: np.random.Generator, value: float) -> float:
    return float(value * random.uniform(0.8, 1.2))


def _in_decade(random: np.random.Generator, value: float) -> float:
    return float(value * 10.0 ** random.uniform(-0.5, 0.5))


def _joint(random: np.random.Generator, ratio: float) -> dict[str, float]:
    """A spherical joint in one arm of three, else a rolling one; it bends at most 70 degrees, and as far as its plates let it."""
    length = _near(random, 0.02507 * ratio)
    is_rolling = bool(random.integers(3))
    pins, offset = is_rolling * length * random.uniform(0.1, 0.6), is_rolling * length * random.uniform(0.0, 0.2)

    def plates_are_apart(degrees: float) -> bool:
        half = math.radians(degrees + 3.0) / 2.0
        height = math.sqrt(length**2 - (pins * math.cos(half)) ** 2) + 2.0 * offset * math.cos(half)
        return SHIPPED_CIRCLE * ratio * math.sin(half) < height

    most = max(degrees for degrees in range(10, 71) if plates_are_apart(degrees))
    limit = float(random.uniform(10.0, most))
    shape = {"crossed_link_length": length, "pin_distance": pins, "plate_to_pin": offset}
    return shape | {"bend_limit_deg": limit, "stop_margin_deg": 2.0}


def _cables(random: np.random.Generator, segments: int, circle: float) -> dict[str, Any]:
    """Holes evenly spaced, a segment's two cables about a right angle apart."""
    angles = np.linspace(0.0, 180.0, 2 * segments, endpoint=False) + random.uniform(0.0, 3.0)
    order = random.permutation(segments)
    return {
        "hole_circle_diameter": circle,
        "hole_angles_deg": [[float(angles[k]), float(angles[k + segments])] for k in order],
        "names": [[2 * k + 1, 2 * k + 2] for k in range(segments)],
    }


def _pull(mapping: dict[str, Any]) -> float:
    """What strands have to hold: mass times length over their lever [kg]."""
    count = sum(mapping["joints_per_segment"])
    length = count * (mapping["joint"]["crossed_link_length"] + mapping["link_length"])
    mass = count * (mapping["mechanics"]["joint_mass"] + mapping["mechanics"]["link_mass"])
    return mass * length / mapping["cables"]["hole_circle_diameter"]
