"""The arm as polygons in the base frame: links, plates, crossed limbs, strands. Enough to look at, not a CAD model."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np

from qjrl.report.palette import ARM
from qjrl.robot.quaternion_arm.description import QuaternionArm
from qjrl.robot.quaternion_arm.kinematics import frames

PLATE_THICKNESS = 0.0025
"""Of the drawn plates [m]."""
LIMB_RADIUS = 0.0014
"""Of the drawn limbs of a joint [m]."""


@dataclasses.dataclass
class Mesh:
    """Flat polygons with colours; a polygon of two points is a line."""

    polygons: list[np.ndarray] = dataclasses.field(default_factory=list)
    """Each (corners, 3) [m]."""
    colours: list[str] = dataclasses.field(default_factory=list)

    def add(self, polygons: list[np.ndarray], colour: str) -> None:
        """Polygons of one colour."""
        self.polygons += polygons
        self.colours += [colour] * len(polygons)

    def __add__(self, other: "Mesh") -> "Mesh":
        return Mesh(self.polygons + other.polygons, self.colours + other.colours)


def arm_mesh(robot: QuaternionArm, bends: np.ndarray) -> Mesh:
    """Polygons of the arm at `bends` (segments, 2): base first, segments in alternating tones."""
    mesh, radius = Mesh(), robot.config.mechanics.link_radius
    base = _Frame(np.zeros(3), np.eye(3))
    mesh.add(cylinder(base, -PLATE_THICKNESS, 0.0, 1.15 * radius), ARM["plate"])
    poses = [_Frame.of(pose) for pose in np.asarray(frames(robot, jnp.asarray(bends)))]
    below, index = base, 0
    for segment, num_joints in enumerate(robot.joints_per_segment):
        for _ in range(num_joints):
            upper, end = poses[index], poses[index + 1]
            _add_joint(mesh, robot, segment, below, upper)
            _add_link(mesh, robot, segment, upper)
            below, index = end, index + 2
    return mesh


def pedestal(robot: QuaternionArm, floor: float) -> Mesh:
    """A column from the base down to a floor [m]."""
    mesh, radius = Mesh(), robot.config.mechanics.link_radius
    base = _Frame(np.zeros(3), np.eye(3))
    mesh.add(cylinder(base, floor, -PLATE_THICKNESS, 0.75 * radius), ARM["base"])
    mesh.add(cylinder(base, floor, floor + 2.0 * PLATE_THICKNESS, 1.8 * radius), ARM["base"])
    return mesh


@dataclasses.dataclass(frozen=True)
class _Frame:
    """A frame in the base frame."""

    position: np.ndarray
    rotation: np.ndarray

    @classmethod
    def of(cls, pose: np.ndarray) -> "_Frame":
        x, y = pose[3:6], pose[6:9]
        return cls(pose[:3], np.stack([x, y, np.cross(x, y)], axis=1))

    def __call__(self, points) -> np.ndarray:
        """Points (n, 3) of this frame, in the base frame."""
        return self.position + np.asarray(points) @ self.rotation.T


def _add_joint(mesh: Mesh, robot: QuaternionArm, segment: int, below: _Frame, upper: _Frame) -> None:
    """Two crossed pairs of limbs between two plates, and every strand that passes."""
    joint, cables = robot.config.joint, robot.config.cables
    reach = max(joint.pin_distance / 2.0, 0.25 * robot.config.mechanics.link_radius)
    for turn in np.arange(4) * math.pi / 2.0:
        pin = reach * np.array([math.cos(turn), math.sin(turn), 0.0])
        offset = np.array([0.0, 0.0, joint.plate_to_pin])
        start, end = below([pin + offset])[0], upper([-pin - offset])[0]
        mesh.add(tube(start, end, LIMB_RADIUS), ARM["limb"])
    angles = np.radians(
        [angle + turn for pair in cables.hole_angles_deg[segment:] for angle in pair for turn in (0, 180)]
    )
    holes = cables.hole_circle_diameter / 2.0 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    mesh.add([np.stack(ends) for ends in zip(below(holes), upper(holes), strict=True)], ARM["strand"])


def _add_link(mesh: Mesh, robot: QuaternionArm, segment: int, lower: _Frame) -> None:
    """A plate, the link, a plate; a link of no length is one plate."""
    radius, length = robot.config.mechanics.link_radius, robot.config.link_length
    tone = ARM["links"][segment % len(ARM["links"])]
    plate = min(PLATE_THICKNESS, max(length, 1e-4) / 3.0)
    mesh.add(cylinder(lower, 0.0, plate, radius), ARM["plate"])
    mesh.add(cylinder(lower, plate, length - plate, 0.86 * radius), tone)
    mesh.add(cylinder(lower, length - plate, length, radius), ARM["plate"])


def cylinder(frame, low: float, high: float, radius: float, num_sides: int = 24) -> list[np.ndarray]:
    """Sides and lids of a cylinder about the z axis of `frame` (a map of points), anticlockwise from outside."""
    angles = np.linspace(0.0, 2.0 * math.pi, num_sides, endpoint=False)
    ring = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    bottom, top = (frame(np.column_stack([ring, np.full(num_sides, height)])) for height in (low, high))
    following = np.roll(np.arange(num_sides), -1)
    sides = [np.stack([bottom[i], bottom[j], top[j], top[i]]) for i, j in enumerate(following)]
    return [*sides, top, bottom[::-1]]


def tube(start: np.ndarray, end: np.ndarray, radius: float, num_sides: int = 6) -> list[np.ndarray]:
    """A thin cylinder between two points."""
    axis = (end - start) / np.linalg.norm(end - start)
    across = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    frame = _Frame(start, np.stack([across, np.cross(axis, across), axis], axis=1))
    return cylinder(frame, 0.0, float(np.linalg.norm(end - start)), radius, num_sides)
