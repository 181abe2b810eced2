"""Flat polygons in space, each of a named part: enough to draw a robot, not a CAD model."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np


@dataclasses.dataclass
class Mesh:
    """Polygons and what they belong to; a polygon of two points is a line."""

    polygons: list[np.ndarray] = dataclasses.field(default_factory=list)
    """Each (corners, 3) [m], anticlockwise from outside."""
    parts: list[str] = dataclasses.field(default_factory=list)
    """Of each polygon, such as "plate": the palette has a colour for it."""

    def add(self, polygons: list[np.ndarray], part: str) -> None:
        """Polygons of one part."""
        self.polygons += polygons
        self.parts += [part] * len(polygons)

    def __add__(self, other: "Mesh") -> "Mesh":
        return Mesh(self.polygons + other.polygons, self.parts + other.parts)


@dataclasses.dataclass(frozen=True)
class Frame:
    """A frame in the base frame: a map of points."""

    position: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))
    rotation: np.ndarray = dataclasses.field(default_factory=lambda: np.eye(3))

    @classmethod
    def of(cls, pose: np.ndarray) -> "Frame":
        """Of a pose (9,)."""
        x, y = pose[3:6], pose[6:9]
        return cls(pose[:3], np.stack([x, y, np.cross(x, y)], axis=1))

    def __call__(self, points: Any) -> np.ndarray:
        """Points (n, 3) of this frame, in the base frame."""
        return self.position + np.asarray(points) @ self.rotation.T


def cylinder(
    frame: Callable[[Any], np.ndarray], low: float, high: float, radius: float, num_sides: int = 24
) -> list[np.ndarray]:
    """Sides and lids of a cylinder about the z axis of `frame`, from `low` to `high` [m]."""
    angles = np.linspace(0.0, 2.0 * math.pi, num_sides, endpoint=False)
    ring = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    bottom, top = (frame(np.column_stack([ring, np.full(num_sides, height)])) for height in (low, high))
    following = np.roll(np.arange(num_sides), -1)
    sides = [np.stack([bottom[i], bottom[j], top[j], top[i]]) for i, j in enumerate(following)]
    return [*sides, top, bottom[::-1]]


def tube(start: np.ndarray, end: np.ndarray, radius: float, num_sides: int = 6) -> list[np.ndarray]:
    """A thin cylinder between two points [m]."""
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / length
    across = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    frame = Frame(start, np.stack([across, np.cross(axis, across), axis], axis=1))
    return cylinder(frame, 0.0, length, radius, num_sides)
