"""The tip alone, carried back from the tip to the base: a dozen operations a joint, for clouds of millions of poses.

A joint's rotation is two half turns, so a vector v of the upper plate is 2 n (n . v') - v' in the lower one, with
v' = (-x, -y, z) and n the joint's half-way direction; no matrix is formed. In float32 the tip is exact to about a micrometre.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.joint import height_of_cosine

Vector = tuple  # (x, y, z) as three scalars: under vmap each is one contiguous array


def tip_position(arm: QuaternionArm, bends: Float[Array, "segments 2"]) -> Float[Array, "3"]:
    """Position of the tip in the base frame [m]; `forward_kinematics` without the rotation, in bends' precision."""
    zero = jnp.zeros((), bends.dtype)
    return jnp.stack(_carry_back(arm, bends, (zero, zero, zero), ())[0])


def tip_pose(arm: QuaternionArm, bends: Float[Array, "segments 2"]) -> Float[Array, "9"]:
    """Pose of the tip in the base frame [m, -]; equal to `forward_kinematics`, in bends' precision."""
    zero, one = jnp.zeros((), bends.dtype), jnp.ones((), bends.dtype)
    point, (x, y) = _carry_back(arm, bends, (zero, zero, zero), ((one, zero, zero), (zero, one, zero)))
    return jnp.stack([*point, *x, *y])


def tip_poses(arm: QuaternionArm, bends: Float[Array, "batch segments 2"]) -> Float[Array, "batch 9"]:
    """Poses of the tip for a batch, equal to `forward_kinematics`: a few operations on whole arrays a joint.

    For converters to other formats, which neither loop nor index: the point and the two directions of the tip frame
    are the rows of one (batch, 3, 3) array.
    """
    cosines = jnp.sqrt(1.0 - jnp.sum(bends**2, axis=2, keepdims=True))
    heights = height_of_cosine(arm.crossed_link_length, arm.pin_distance, arm.plate_to_pin, cosines)
    normals = jnp.concatenate([bends, cosines], axis=2)  # (batch, segments, 3)
    is_point, half_turn = jnp.array([[1.0], [0.0], [0.0]], bends.dtype), jnp.array([-1.0, -1.0, 1.0], bends.dtype)
    link = is_point * jnp.array([0.0, 0.0, 1.0], bends.dtype) * arm.link_length
    vectors = jnp.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]], bends.dtype)
    for segment in np.repeat(np.arange(arm.num_segments), arm.joints_per_segment)[::-1].tolist():
        normal, height = normals[:, segment : segment + 1], heights[:, segment : segment + 1]
        turned = (vectors + link) * half_turn
        along = is_point * height + 2.0 * jnp.sum(turned * normal, axis=2, keepdims=True)
        vectors = along * normal - turned
    return vectors.reshape(-1, 9)


def _carry_back(arm: QuaternionArm, bends, point: Vector, directions: tuple[Vector, ...]):
    """A point and directions of the tip frame in the base frame (paper 000, Eqs. 2-3, from the last joint to the first)."""
    for segment in reversed(range(arm.num_segments)):
        x, y = bends[segment, 0], bends[segment, 1]
        n = (x, y, jnp.sqrt(1.0 - x * x - y * y))
        height = height_of_cosine(arm.crossed_link_length, arm.pin_distance, arm.plate_to_pin, n[2])
        for _ in range(arm.joints_per_segment[segment]):
            point = _reflect(n, (point[0], point[1], point[2] + arm.link_length), height)
            directions = tuple(_reflect(n, direction) for direction in directions)
    return point, directions


def _reflect(n: Vector, vector: Vector, height: jax.Array | float = 0.0) -> Vector:
    """height n + R vector."""
    along = height + 2.0 * (n[2] * vector[2] - n[0] * vector[0] - n[1] * vector[1])
    return n[0] * along + vector[0], n[1] * along + vector[1], n[2] * along - vector[2]
