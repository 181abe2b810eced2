"""How the arm is drawn: links, plates, crossed limbs, strands."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.geometry.mesh import Frame, Mesh, cylinder, tube
from qjrl.robot.drawing import Drawing
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.kinematics import frames

PLATE_THICKNESS = 0.0025
"""Of the drawn plates [m]."""
LIMB_RADIUS = 0.0014
"""Of the drawn limbs of a joint [m]."""


def arm_mesh(arm: QuaternionArm, bends: np.ndarray) -> Mesh:
    """Polygons of the arm at `bends` (segments, 2): base first, segments in alternating tones."""
    mesh, radius = Mesh(), arm.config.mechanics.link_radius
    base = Frame()
    mesh.add(cylinder(base, -PLATE_THICKNESS, 0.0, 1.15 * radius), "plate")
    poses = [Frame.of(pose) for pose in np.asarray(frames(arm, jnp.asarray(bends)))]
    below, index = base, 0
    for segment, num_joints in enumerate(arm.joints_per_segment):
        for _ in range(num_joints):
            upper, end = poses[index], poses[index + 1]
            _add_joint(mesh, arm, segment, below, upper)
            _add_link(mesh, arm, segment, upper)
            below, index = end, index + 2
    return mesh


def _add_joint(mesh: Mesh, arm: QuaternionArm, segment: int, below: Frame, upper: Frame) -> None:
    """Two crossed pairs of limbs between two plates, and every strand that passes."""
    joint, cables = arm.config.joint, arm.config.cables
    reach = max(joint.pin_distance / 2.0, 0.25 * arm.config.mechanics.link_radius)
    for turn in np.arange(4) * math.pi / 2.0:
        pin = reach * np.array([math.cos(turn), math.sin(turn), 0.0])
        offset = np.array([0.0, 0.0, joint.plate_to_pin])
        start, end = below([pin + offset])[0], upper([-pin - offset])[0]
        mesh.add(tube(start, end, LIMB_RADIUS), "limb")
    angles = np.radians(
        [angle + turn for pair in cables.hole_angles_deg[segment:] for angle in pair for turn in (0, 180)]
    )
    holes = cables.hole_circle_diameter / 2.0 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    mesh.add([np.stack(ends) for ends in zip(below(holes), upper(holes), strict=True)], "strand")


def _add_link(mesh: Mesh, arm: QuaternionArm, segment: int, lower: Frame) -> None:
    """A plate, the link, a plate; a link of no length is one plate."""
    radius, length = arm.config.mechanics.link_radius, arm.config.link_length
    plate = min(PLATE_THICKNESS, max(length, 1e-4) / 3.0)
    mesh.add(cylinder(lower, 0.0, plate, radius), "plate")
    mesh.add(cylinder(lower, plate, length - plate, 0.86 * radius), f"link_{segment % 2}")
    mesh.add(cylinder(lower, length - plate, length, radius), "plate")


def skeleton(arm: QuaternionArm, bends: jax.Array) -> jax.Array:
    """(1 + 2 joints, 3) [m]: the base, then both ends of every link."""
    return jnp.concatenate([jnp.zeros((1, 3), bends.dtype), frames(arm, bends)[:, :3]])


def sections(arm: QuaternionArm) -> list[int]:
    """The segment of each line: a joint and its link are two."""
    return np.repeat(np.arange(arm.num_segments), 2 * np.array(arm.joints_per_segment)).tolist()


def link_radius(arm: QuaternionArm) -> float:
    """[m]."""
    return float(arm.link_radius)


DRAWING = Drawing(arm_mesh, skeleton, sections, link_radius)
