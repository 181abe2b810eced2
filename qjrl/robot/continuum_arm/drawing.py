"""How the arm is drawn: its hose, its discs, its cables."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.geometry.mesh import Frame, Mesh, cylinder, tube
from qjrl.geometry.pose import position_of, rotation_of
from qjrl.robot.continuum_arm.arm import ContinuumArm
from qjrl.robot.continuum_arm.kinematics import frames
from qjrl.robot.continuum_arm.segment import segment_pose
from qjrl.robot.drawing import Drawing

PIECES = 8
"""Straight pieces that an arc is drawn with."""
DISC_THICKNESS = 0.004
"""Of the drawn discs [m]."""
HOSE_SHARE = 0.18
"""Radius of the drawn hose, as a share of the anchors' circle."""


def arm_mesh(arm: ContinuumArm, bends: np.ndarray) -> Mesh:
    """Polygons of the arm at `bends` (segments, 2) [rad]: base first, segments in alternating tones."""
    mesh, radii = Mesh(), np.asarray(arm.anchor_radii)
    points = np.asarray(skeleton(arm, jnp.asarray(bends)))
    ends = [Frame(), *(Frame.of(pose) for pose in np.asarray(frames(arm, jnp.asarray(bends))))]
    mesh.add(cylinder(ends[0], -DISC_THICKNESS, 0.0, 1.15 * radii[0]), "plate")
    directions = np.asarray(arm.anchor_directions)
    for segment, radius in enumerate(radii):
        below, above = ends[segment], ends[segment + 1]
        arc = points[segment * PIECES : (segment + 1) * PIECES + 1]
        for start, end in itertools.pairwise(arc):
            mesh.add(tube(start, end, HOSE_SHARE * radius, 10), f"link_{segment % 2}")
        mesh.add(cylinder(above, -DISC_THICKNESS, 0.0, 1.1 * radius), "plate")
        anchors = np.column_stack([radius * directions[segment], np.zeros(arm.cables_per_segment)])
        mesh.add([np.stack(pair) for pair in zip(below(anchors), above(anchors), strict=True)], "strand")
    return mesh


def skeleton(arm: ContinuumArm, bends: jax.Array) -> jax.Array:
    """(1 + PIECES segments, 3) [m] along the backbone's arcs."""
    starts = jnp.concatenate([jnp.array([[0.0, 0, 0, 1, 0, 0, 0, 1, 0]], bends.dtype), frames(arm, bends)[:-1]])
    shares = jnp.arange(1, PIECES + 1, dtype=bends.dtype) / PIECES

    def of_segment(start: jax.Array, length: jax.Array, bend: jax.Array) -> jax.Array:
        along = jax.vmap(lambda share: segment_pose(share * length, share * bend)[0])(shares)
        return position_of(start) + along @ rotation_of(start).T

    points = jax.vmap(of_segment)(starts, jnp.asarray(arm.segment_lengths, bends.dtype), bends)
    return jnp.concatenate([jnp.zeros((1, 3), bends.dtype), points.reshape(-1, 3)])


def sections(arm: ContinuumArm) -> list[int]:
    """The segment of each line."""
    return np.repeat(np.arange(arm.num_segments), PIECES).tolist()


def hose_radius(arm: ContinuumArm) -> float:
    """[m]."""
    return HOSE_SHARE * float(np.max(np.asarray(arm.anchor_radii)))


DRAWING = Drawing(arm_mesh, skeleton, sections, hose_radius)
