"""What a kind of robot gives to those that draw it."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from qjrl.geometry.mesh import Mesh


@dataclasses.dataclass(frozen=True)
class Drawing:
    """Functions of a robot, on the host."""

    mesh: Callable[[Any, np.ndarray], Mesh]
    """(robot, configuration) -> its polygons in the base frame [m]."""
    skeleton: Callable[..., Any]
    """(robot, configuration) -> points (n, 3) from the base to the tip [m], in JAX."""
    sections: Callable[[Any], list[int]]
    """robot -> the section that each of the n - 1 lines between them belongs to; sections get tones in turn."""
    radius: Callable[[Any], float]
    """robot -> radius of its links [m]: of a pedestal under it, and of the lines."""
