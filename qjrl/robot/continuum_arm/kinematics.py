"""The nominal arm: product of its segments' poses, its cables, and its bends from them (paper 002, Eqs. 2 to 13)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qjrl.geometry.pose import pose_from_frame
from qjrl.robot.continuum_arm.arm import ContinuumArm
from qjrl.robot.continuum_arm.segment import segment_bend, segment_cables, segment_pose


def frames(arm: ContinuumArm, bends: Float[Array, "segments 2"]) -> Float[Array, "segments 9"]:
    """Pose of every segment's end in the base frame, the last one the tip's (Eq. 13)."""
    position, rotation, poses = jnp.zeros(3, bends.dtype), jnp.eye(3, dtype=bends.dtype), []
    for number in range(arm.num_segments):
        shift, turn = segment_pose(_of(arm.segment_lengths, number, bends), bends[number])
        position, rotation = position + rotation @ shift, rotation @ turn
        poses.append(pose_from_frame(position, rotation))
    return jnp.stack(poses)


def forward_kinematics(arm: ContinuumArm, bends: Float[Array, "segments 2"]) -> Float[Array, "9"]:
    """Pose of the tip in the base frame [m, -]."""
    return frames(arm, bends)[-1]


def cable_lengths(arm: ContinuumArm, bends: Float[Array, "segments 2"]) -> Float[Array, "cables"]:
    """Cable lengths relative to the straight arm, + pays out [m]; segment by segment."""
    lengths = jnp.asarray(arm.segment_lengths, bends.dtype)
    of_each = jax.vmap(segment_cables)(
        lengths, jnp.asarray(arm.anchor_radii, bends.dtype), arm.anchor_directions.astype(bends.dtype), bends
    )
    return (of_each - lengths[:, None]).reshape(-1)


def bends_from_cables(arm: ContinuumArm, lengths: Float[Array, "cables"]) -> Float[Array, "segments 2"]:
    """Bends of cable lengths [m], closed form; what a segment's cables have in common is stiffness, not shape."""
    per_segment = lengths.reshape(arm.num_segments, arm.cables_per_segment)
    radii = jnp.asarray(arm.anchor_radii, lengths.dtype)
    return jax.vmap(segment_bend)(radii, arm.anchor_directions.astype(lengths.dtype), per_segment)


def cable_strokes(arm: ContinuumArm) -> Float[Array, "cables"]:
    """Largest |cable length| over all bends within the limit [m]: of the cable on the inside of the sharpest bend."""
    limit, lengths = arm.bend_limit, jnp.asarray(arm.segment_lengths)
    shortest = jax.vmap(lambda length, radius: segment_cables(length, radius, jnp.eye(2)[:1], limit * jnp.eye(2)[0])[0])
    strokes = lengths - shortest(lengths, jnp.asarray(arm.anchor_radii))
    return jnp.repeat(strokes, arm.cables_per_segment)


def _of(values: Array, number: int, like: Array) -> Array:
    return jnp.asarray(values, like.dtype)[number]
