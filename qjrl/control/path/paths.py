"""Paths of poses: a line, a circle, or the points of a file joined by a smooth curve, sampled evenly along their length."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from qjrl.config import ConfigError, Range, configuration
from qjrl.control.path.files import read_points, smooth_curve
from qjrl.robot.verbs import Robot
from qjrl.table_file import FILE_KINDS

Constraint = Literal["pose", "pointing", "position"]
"""What of a pose counts: all six degrees of freedom, position and direction of the tip's z axis, or position alone."""
Vector = tuple[float, float, float]
Curve = Callable[[np.ndarray], tuple[np.ndarray, Rotation | None]]
"""Positions (n, 3) [m] and rotations at values (n,) of a parameter from 0 to 1; None: no orientation is given."""

ROTATION_WEIGHT = 0.1
"""What a turn counts against a displacement in the length of a path [m/rad]."""
_FINE = 64
"""Points of a curve between two samples, to measure its length by."""


@configuration
class CircleConfig:
    """A circle, run through once from `start_deg`."""

    centre: Vector = (0.0, 0.0, 0.44)
    """[m] in the base frame."""
    radius: Annotated[float, Range(above=0.0)] = 0.05
    """[m]."""
    normal: Vector = (0.0, 0.0, 1.0)
    """Of its plane; the circle runs anticlockwise about it."""
    start_deg: float = 0.0
    """Where it begins, about the normal; 0 is the direction nearest to the base's x axis [deg]."""

    def __post_init__(self):
        if not np.linalg.norm(self.normal) > 0.0:
            raise ValueError(f"normal: got {list(self.normal)}, allowed: any but zero")


@dataclasses.dataclass(frozen=True)
class LineConfig:
    """A straight line."""

    start: Vector = (-0.05, 0.0, 0.44)
    """[m] in the base frame."""
    end: Vector = (0.05, 0.0, 0.44)
    """[m]."""


@configuration
class ShapeConfig:
    """What a path looks like."""

    orientation: Literal["given", "fixed", "tangent", "free"] = "given"
    """"given": a file's own, free where it has none; a circle and a line are fixed. "fixed": `rotation_vector_deg` all
    along. "tangent": the tip's z axis leans from the circle's normal (a line or file: from z) by `lean_deg` towards the
    direction of travel, its roll free. "free": position alone counts."""
    rotation_vector_deg: Vector = (0.0, 0.0, 0.0)
    """Orientation of "fixed", axis times angle in the base frame [deg]; 0 is the tip straight up."""
    lean_deg: Annotated[float, Range(low=-180.0, high=180.0)] = 20.0
    """Lean of "tangent" [deg]."""
    circle: CircleConfig = CircleConfig()
    """Path "circle"."""
    line: LineConfig = LineConfig()
    """Path "line"."""
    spacing: Annotated[float, Range(low=1e-4, high=0.05)] = 0.002
    """Distance of two waypoints along the path [m]; a turn counts 0.1 m/rad."""


@dataclasses.dataclass(frozen=True)
class PosePath:
    """Waypoints, evenly spaced along the path."""

    pose: np.ndarray
    """(n, 9) [m, -]; what does not count of them is arbitrary."""
    distance: np.ndarray
    """(n,) along the path [m], a turn counts 0.1 m/rad."""
    constraint: Constraint
    at: Callable[[np.ndarray], np.ndarray]
    """Distances (k,) along the path [m] -> poses (k, 9)."""
    key: str
    """The setting that names it, for messages."""

    @property
    def length(self) -> float:
        """[m]."""
        return float(self.distance[-1])

    @property
    def is_closed(self) -> bool:
        """Whether it ends where it began."""
        return bool(np.allclose(self.pose[0], self.pose[-1], atol=1e-6))


def make_path(source: str, config: ShapeConfig, key: str = "track.path", robot: Robot | None = None) -> PosePath:
    """The waypoints of a path.

    Args:
        source: "circle", "line", or a file with at least two points, which a smooth curve joins. A .csv has columns x, y, z
            [m] and, where orientation counts, qw, qx, qy, qz or the first two columns of the rotation xx, xy, xz, yx, yy,
            yz, in any order; an .npz has arrays `position` (n, 3), with or without `quaternion` (n, 4), w first, or `pose`
            (n, 9).
        key: the setting that names it, for messages.
        robot: whose reach the points of a file are held against before the curve is made.
    Raises:
        ConfigError: unknown source; the file is missing, has other columns, non-finite values, too few points or some out of
            reach; or the path is shorter than its spacing.
    """
    file = path_file(source, key)
    try:
        curve = _SHAPES[source](config) if file is None else smooth_curve(read_points(file, robot))
    except ConfigError as error:
        raise ConfigError(f"{key}: {error}") from error
    shape = _Shape(
        config, curve, is_file=file is not None, up=config.circle.normal if source == "circle" else (0, 0, 1)
    )
    parameter = np.linspace(0.0, 1.0, _FINE * 256 + 1)
    length = shape.distances(parameter)
    if length[-1] < 2.0 * config.spacing:
        raise ConfigError(
            f"{key}: {source} is {1e3 * length[-1]:.3g} mm long, allowed: at least {2e3 * config.spacing:.3g} mm, twice the "
            "waypoints' spacing"
        )
    distance = np.linspace(0.0, length[-1], max(math.ceil(length[-1] / config.spacing), 16) + 1)

    def at(distance: np.ndarray) -> np.ndarray:
        return shape.poses(np.interp(distance, length, parameter))

    return PosePath(at(distance), distance, shape.constraint, at, key)


def path_file(source: str, key: str = "track.path") -> Path | None:
    """The file that a path is read from, None for a shape.

    Raises:
        ConfigError: neither.
    """
    if source in _SHAPES:
        return None
    if Path(source).suffix not in FILE_KINDS:
        known = f"{', '.join(_SHAPES)}, or a file that ends in {' or '.join(FILE_KINDS)}"
        raise ConfigError(f"{key}: got '{source}', allowed: {known}")
    return Path(source)


@dataclasses.dataclass(frozen=True)
class _Shape:
    """A curve with its orientation."""

    config: ShapeConfig
    curve: Curve
    is_file: bool
    up: Vector
    """From where "tangent" leans."""

    @property
    def constraint(self) -> Constraint:
        if self.config.orientation == "given":
            has_own = self.curve(np.zeros(1))[1] is not None
            return "pose" if has_own or not self.is_file else "position"
        return {"fixed": "pose", "tangent": "pointing", "free": "position"}[self.config.orientation]  # pyright: ignore[reportReturnType]

    def distances(self, parameter: np.ndarray) -> np.ndarray:
        """Length of the curve up to every parameter [m], turns counted where orientation counts."""
        poses = self.poses(parameter)
        steps = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
        if self.constraint == "pose":
            turns = (_rotations(poses[:-1]).inv() * _rotations(poses[1:])).magnitude()
            steps = np.hypot(steps, ROTATION_WEIGHT * turns)
        return np.concatenate([[0.0], np.cumsum(steps)])

    def poses(self, parameter: np.ndarray) -> np.ndarray:
        """Poses (n, 9)."""
        position, rotation = self.curve(parameter)
        if self.config.orientation == "tangent":
            rotation = _leaning(self.config.lean_deg, self.up, _directions(self.curve, parameter))
        elif self.config.orientation == "fixed" or rotation is None:
            fixed = Rotation.from_rotvec(np.radians(self.config.rotation_vector_deg)).as_matrix()
            rotation = Rotation.from_matrix(np.broadcast_to(fixed, (len(position), 3, 3)))
        matrix = rotation.as_matrix()
        return np.concatenate([position, matrix[:, :, 0], matrix[:, :, 1]], axis=1)


def _directions(curve: Curve, parameter: np.ndarray) -> np.ndarray:
    """Unit direction of travel (n, 3)."""
    step = 1e-7
    ahead, behind = (curve(np.clip(parameter + sign * step, 0.0, 1.0))[0] for sign in (1.0, -1.0))
    difference = ahead - behind
    return difference / np.maximum(np.linalg.norm(difference, axis=1, keepdims=True), 1e-300)


def _leaning(lean_deg: float, up: Vector, direction: np.ndarray) -> Rotation:
    """Frames whose z axis leans from `up` towards the direction of travel (n, 3)."""
    up_unit = np.asarray(up, float) / np.linalg.norm(up)
    axis = np.cross(up_unit, direction)
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-300)
    upright = Rotation.align_vectors(up_unit[None], [[0.0, 0.0, 1.0]])[0]
    return Rotation.from_rotvec(math.radians(lean_deg) * axis) * upright


def _circle(config: ShapeConfig) -> Curve:
    circle = config.circle
    normal = np.asarray(circle.normal) / np.linalg.norm(circle.normal)
    reference = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = reference - (reference @ normal) * normal
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)

    def curve(parameter: np.ndarray) -> tuple[np.ndarray, Rotation | None]:
        angle = math.radians(circle.start_deg) + 2.0 * math.pi * parameter[:, None]
        return np.asarray(circle.centre) + circle.radius * (np.cos(angle) * first + np.sin(angle) * second), None

    return curve


def _line(config: ShapeConfig) -> Curve:
    start, end = np.asarray(config.line.start), np.asarray(config.line.end)
    return lambda parameter: (start + parameter[:, None] * (end - start), None)


def _rotations(poses: np.ndarray) -> Rotation:
    x, y = poses[:, 3:6], poses[:, 6:9]
    return Rotation.from_matrix(np.stack([x, y, np.cross(x, y)], axis=2))


_SHAPES = {"circle": _circle, "line": _line}
