"""Closed-form pose of the whole arm: segment k is m_k times (joint, link), all joints of a segment bent alike."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qjrl.geometry.pose import pose_from_frame
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.joint import joint_transform


def forward_kinematics(arm: QuaternionArm, bends: Float[Array, "segments 2"]) -> Float[Array, "9"]:
    """Tip pose in the base frame, [m] and columns of the rotation (paper 000, Eqs. 2-3 composed)."""
    tip, _ = _walk(arm, bends)
    return pose_from_frame(*tip)


def frames(arm: QuaternionArm, bends: Float[Array, "segments 2"]) -> Float[Array, "frames 9"]:
    """Poses along the arm: upper plate and link end of every joint, from the base to the tip."""
    _, poses = _walk(arm, bends)
    return poses.reshape(-1, 9)


def _walk(arm: QuaternionArm, bends: jax.Array):
    """Frame of the tip, and the poses (joints, 2, 9) passed; a scan compiles and runs faster than an unrolled loop."""
    offsets, rotations = jax.vmap(lambda bend: joint_transform(arm, bend))(bends)

    def cross_joint(frame, segment):
        position, rotation = frame
        plate, turned = position + rotation @ offsets[segment], rotation @ rotations[segment]
        end = plate + turned[:, 2] * arm.link_length
        return (end, turned), jnp.stack([pose_from_frame(plate, turned), pose_from_frame(end, turned)])

    base = (jnp.zeros(3, offsets.dtype), jnp.eye(3, dtype=offsets.dtype))
    return jax.lax.scan(cross_joint, base, np.repeat(np.arange(arm.num_segments), arm.joints_per_segment))
