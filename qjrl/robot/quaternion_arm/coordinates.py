"""Between the bends and the joint positions of the MJCF (`mjcf.build_mjcf` states their order)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.joint import half_direction, joint_height


def joint_positions(arm: QuaternionArm, bends: Float[Array, "segments 2"]) -> Float[Array, "nq"]:
    """Positions of all hinges [rad] and slides [m] at given bends, on the constraint manifold."""
    per_segment = jax.vmap(lambda bend: _one_joint(arm, bend))(bends)
    return jnp.repeat(
        per_segment, jnp.array(arm.joints_per_segment), axis=0, total_repeat_length=arm.num_joints
    ).reshape(-1)


def bends_from_joint_positions(arm: QuaternionArm, positions: Float[Array, "nq"]) -> Float[Array, "segments 2"]:
    """Bends of the segments: the mean over the joints of each, of the direction of their chord."""
    bends = bends_from_half_angles(positions.reshape(arm.num_joints, -1)[:, :2])  # (num_joints, 2)
    owner = jnp.repeat(
        jnp.arange(arm.num_segments), jnp.array(arm.joints_per_segment), total_repeat_length=arm.num_joints
    )
    return jax.ops.segment_sum(bends, owner, arm.num_segments) / jnp.array(arm.joints_per_segment)[:, None]


def half_angles(bend: Float[Array, "2"]) -> Float[Array, "2"]:
    """Half angles x, y [rad] with Rx(x) Ry(y) e_z = n, the half-way direction of a bend."""
    n = half_direction(bend)
    return jnp.stack([-jnp.arctan2(n[1], n[2]), jnp.arcsin(n[0])])


def bends_from_half_angles(angles: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
    """Inverse of `half_angles`."""
    x, y = angles[..., 0], angles[..., 1]
    return jnp.stack([jnp.sin(y), -jnp.sin(x) * jnp.cos(y)], axis=-1)


def _one_joint(arm: QuaternionArm, bend: Float[Array, "2"]) -> Float[Array, "coordinates"]:
    """Half angles, the slide, and the mirrored halves."""
    x, y = half_angles(bend)
    slide = joint_height(arm, bend) - joint_height(arm, jnp.zeros(2))
    return jnp.stack([x, y, slide, y, x] if arm.joint_model == "rolling" else [x, y, y, x])
