"""Closed-form pose of the whole arm: segment k is m_k times (joint, link), all joints of a segment bent alike."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qjrl.geometry.pose import pose_from_frame
from qjrl.robot.quaternion_arm.description import QuaternionArm
from qjrl.robot.quaternion_arm.joint import joint_transform


def forward_kinematics(arm: QuaternionArm, bends: Float[Array, "segments 2"]) -> Float[Array, "9"]:
    """Tip pose in the base frame, [m] and columns of the rotation (paper 000, Eqs. 2-3 composed)."""
    return frames(arm, bends)[-1]


def segment_frames(arm: QuaternionArm, bends: Float[Array, "segments 2"]) -> Float[Array, "segments 9"]:
    """Pose of the end of every segment in the base frame."""
    ends = jnp.cumsum(jnp.array(arm.joints_per_segment)) * 2 - 1
    return frames(arm, bends)[ends]


def frames(arm: QuaternionArm, bends: Float[Array, "segments 2"]) -> Float[Array, "frames 9"]:
    """Poses along the arm: upper plate and link end of every joint, from the base to the tip."""
    offsets, rotations = jax.vmap(lambda bend: joint_transform(arm, bend))(bends)
    position, rotation, poses = jnp.zeros(3), jnp.eye(3), []
    for segment, num_joints in enumerate(arm.joints_per_segment):
        for _ in range(num_joints):
            position = position + rotation @ offsets[segment]
            rotation = rotation @ rotations[segment]
            poses.append(pose_from_frame(position, rotation))
            position = position + rotation[:, 2] * arm.link_length
            poses.append(pose_from_frame(position, rotation))
    return jnp.stack(poses)
