"""Equations of motion in minimal coordinates: the half angles (x, y) of each segment's joints, two numbers a segment.

All joints of a segment share them: what the physics of `mjcf` ties together with equality rows is one coordinate here.
Forces come from recursive Newton-Euler, the mass matrix from composite bodies, both from segment to segment.

A rigid body counts as four weighted points (`segment_shape`): its centre, weighted by the mass, and the tips of its axes,
weighted by c_i = tr(I)/2 - I_ii. Then sum w |dz/dt|^2 is twice its kinetic energy, and bodies need no angular velocity.
Components come first and a batch of arms last, as in `geometry.batch_last`.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.geometry.vectors import IDENTITY, ZERO
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.segment_chain import Load, in_order, mass_and_force, row
from qjrl.robot.quaternion_arm.segment_shape import SegmentMotion, height_at, segment_motion, segment_motions

__all__ = [
    "Equations",
    "Load",
    "equations_of_motion",
    "hinge_damping",
    "hinge_stiffness",
    "joint_coordinates",
    "tip_pose",
]


@struct.dataclass
class Equations:
    """mass (d rates / dt) = force + springs, dampers, strands; coordinates segment by segment, x before y."""

    mass: jax.Array
    """(coordinates, coordinates, *batch) [kg m^2]."""
    force: jax.Array
    """(coordinates, *batch) of gravity and Coriolis [N m]."""
    strands: jax.Array
    """(strands, *batch) lengths inside the joints, as `cables.strand_lengths` [m]."""
    strand_slope: jax.Array
    """(coordinates, strands, *batch) [m/rad]."""
    cosines: jax.Array
    """(segments, *batch) cos(theta/2), which falls as the joints bend."""
    cosine_slope: jax.Array
    """(coordinates, segments, *batch)."""


def equations_of_motion(arm: QuaternionArm, load: Load, half_angles: jax.Array, rates: jax.Array) -> Equations:
    """At half angles [rad] and rates [rad/s], both (segments, 2, *batch)."""
    motions = segment_motions(arm, half_angles, rates)
    like, count = jnp.zeros_like(half_angles[0, 0]), arm.num_segments
    bare = {size: dataclasses.replace(motion, chords=[], links=[]) for size, motion in motions.items()}
    motion = in_order(arm, bare, like)
    mass, force = mass_and_force(arm, load, motions, motion, rates)
    strands, strand_slope = _strands(arm, motion)
    slopes = motion.cosine.slope
    cosine_slope = [_only(row(slopes[k % 2], k // 2), k // 2, count) for k in range(2 * count)]
    return Equations(
        jnp.stack([jnp.stack(entries) for entries in mass]),
        jnp.stack(force),
        strands,
        strand_slope,
        motion.cosine.at,
        jnp.stack(cosine_slope),
    )


def tip_pose(arm: QuaternionArm, half_angles: jax.Array) -> jax.Array:
    """Pose (9, *batch) [m, -] of the tip at half angles (segments, 2, *batch) [rad]."""
    position, rotation = ZERO, IDENTITY
    for count, pair in zip(arm.joints_per_segment, half_angles, strict=True):
        segment = segment_motion(arm, count, (pair[0], pair[1]), (0.0, 0.0))
        position = position + rotation.times(segment.end.at)
        rotation = rotation.product(segment.rotation)
    return jnp.stack(jax.tree.leaves((position, rotation.x, rotation.y)))


def joint_coordinates(arm: QuaternionArm, half_angles: jax.Array) -> jax.Array:
    """Joint positions (nq, *batch) of the MJCF at half angles (segments, 2, *batch): hinges [rad] and slides [m]."""
    x, y = half_angles[:, 0], half_angles[:, 1]
    slides = height_at(arm, jnp.cos(x) * jnp.cos(y)) - height_at(arm, jnp.ones((), x.dtype))
    joint = jnp.stack([x, y, slides, y, x] if arm.joint_model == "rolling" else [x, y, y, x], axis=1)
    return jnp.concatenate([joint[k] for k, count in enumerate(arm.joints_per_segment) for _ in range(count)])


def hinge_stiffness(arm: QuaternionArm) -> jax.Array:
    """(coordinates,) [N m/rad]: four hinges of a joint carry 1/2 K theta^2 together."""
    return 4.0 * arm.joint_stiffness * jnp.asarray(np.repeat(arm.joints_per_segment, 2), float)


def hinge_damping(arm: QuaternionArm) -> jax.Array:
    """(coordinates,) [N m s/rad]."""
    return 4.0 * arm.joint_damping * jnp.asarray(np.repeat(arm.joints_per_segment, 2), float)


def _strands(arm: QuaternionArm, motion: SegmentMotion) -> tuple[jax.Array, jax.Array]:
    """Lengths and slopes: half differences are linear in the bends, means the sum of the heights of the joints crossed.

    A cable of segment k sees the sum of m_j a_j over the segments j <= k that it crosses.
    """
    dtype = motion.height.at.dtype
    angles = arm.hole_angles.astype(dtype)
    across = -jnp.asarray(arm.hole_circle_diameter, dtype) * jnp.stack([jnp.cos(angles), jnp.sin(angles)])
    counts = arm.joints_per_segment
    height, bend_x, bend_y, lengths = 0.0, 0.0, 0.0, []
    for segment, count in enumerate(counts):
        here = row((motion.height.at, motion.bend), segment)
        height = height + count * here[0]
        bend_x, bend_y = bend_x + count * here[1][0], bend_y + count * here[1][1]
        for hole in range(2):
            difference = across[0, segment, hole] * bend_x + across[1, segment, hole] * bend_y
            lengths += [height + difference, height - difference]
    zero, slopes = jnp.zeros_like(lengths[0]), []
    for coordinate in range(2 * len(counts)):
        own, k = coordinate // 2, coordinate % 2
        common, by_x, by_y = (
            counts[own] * value for value in row((motion.height.slope[k], *motion.bend_slope[k]), own)
        )
        values = [zero] * (4 * own)
        for segment in range(own, len(counts)):
            for hole in range(2):
                difference = across[1, segment, hole] * by_y
                if k:
                    difference = across[0, segment, hole] * by_x + difference
                values += [common + difference, common - difference]
        slopes.append(jnp.stack(values))
    return jnp.stack(lengths), jnp.stack(slopes)


def _only(value: jax.Array, place: int, size: int) -> jax.Array:
    """(size, *batch) zeros but for one."""
    return jnp.stack([value if k == place else jnp.zeros_like(value) for k in range(size)])
