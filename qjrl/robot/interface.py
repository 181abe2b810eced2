"""What a kind of robot gives to controllers outside the package: the words of the contract, and what a sound reading keeps to."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

ANGLE_MARGIN = math.radians(6.0)
"""What noise of the encoders and give of the stops may add to a bend [rad]."""


@dataclasses.dataclass(frozen=True)
class ReadingLimits:
    """What a reading of a sound encoder keeps to, in every row of a configuration."""

    angle: float
    """Largest bend of a joint [rad]."""
    speed: float
    """Largest rate of a joint's bend [rad/s]."""
    jump: float
    """What two readings may differ by besides, however short the time between them [rad]."""


@dataclasses.dataclass(frozen=True)
class Interface:
    """Functions of a robot, on the host."""

    contract: Callable[[Any], dict[str, Any]]
    """robot -> what `contract.json` says of it beside what all kinds have: cables, motors, limits of commands, homing.
    Its "robot" and "conventions" are added to what is said of all kinds."""
    reading_limits: Callable[[Any], ReadingLimits]
    """robot -> limits of its encoders' readings."""
    pulley_radius: Callable[[Any], float]
    """robot -> cable length for each radian of a motor [m/rad]."""


def quantity(value: Any, unit: str) -> dict[str, Any]:
    """A number with its unit, as the contract writes it."""
    return {"value": float(value), "unit": unit}
