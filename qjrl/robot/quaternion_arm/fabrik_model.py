"""The virtual model of FABRIK: a segment as three points and two directions (paper 000, section 3, Eqs. 4-7, Fig. 3)."""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from qjrl.geometry.rotations import safe_norm
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.joint import bend_angle, height_of_cosine, joint_transform


@struct.dataclass
class VirtualArm:
    """Points and directions of one segment or of all. P_b and Z_b of a segment are P_e and Z_e of the one before it."""

    bases: Float[Array, "*segments 3"]
    """P_b [m]."""
    joints: Float[Array, "*segments 3"]
    """P_j, where the lines along Z_b and Z_e meet [m]."""
    ends: Float[Array, "*segments 3"]
    """P_e [m]."""
    base_directions: Float[Array, "*segments 3"]
    """Z_b."""
    end_directions: Float[Array, "*segments 3"]
    """Z_e."""
    angles: Float[Array, "*segments"]
    """theta_k of one joint of each segment [rad]."""


def virtual_arm(robot: QuaternionArm, bends: Float[Array, "segments 2"]) -> VirtualArm:
    """The virtual model of a configuration, anchored at the base."""
    base, rotation, rows = jnp.zeros(3, bends.dtype), jnp.eye(3, dtype=bends.dtype), []
    for count, bend in zip(robot.joints_per_segment, bends, strict=True):
        angle, direction = bend_angle(bend), rotation[:, 2]
        before, after = segment_lengths(robot, count, angle)
        rotation = rotation @ jnp.linalg.matrix_power(joint_transform(robot, bend)[1], count)
        joint = base + before * direction
        rows.append(VirtualArm(base, joint, joint + after * rotation[:, 2], direction, rotation[:, 2], angle))
        base = rows[-1].ends
    return stack(rows)


def segment_lengths(
    robot: QuaternionArm, count: int, angle: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """l_1 from P_b to P_j and l_2 from P_j to P_e of a segment of `count` joints bent by `angle` each [m].

    They grow without bound towards m theta = 180 degrees, where the two lines are parallel; `angle` is held below it.
    Source: paper 000, Eqs. 4-7, with the height H(theta) of the rolling joint for h.
    """
    angle = jnp.minimum(angle, (jnp.pi - SMALLEST_GAP) / count)
    height = height_of_cosine(robot.crossed_link_length, robot.pin_distance, robot.plate_to_pin, jnp.cos(angle / 2.0))
    half = (
        _odd(count, angle, height, robot.link_length) if count % 2 else _even(count, angle, height, robot.link_length)
    )
    before = half / (2.0 * jnp.cos(count * angle / 2.0))  # Eq. 4
    return before, before + robot.link_length  # Eq. 7


def _odd(count: int, angle, height, link):
    """K_odd, Eq. 5."""
    indices = range(1, (count - 1) // 2 + 1)
    joints = height + 2.0 * height * sum(jnp.cos(i * angle) for i in indices)
    return joints + 2.0 * link * sum(jnp.cos((2 * i - 1) / 2.0 * angle) for i in indices)


def _even(count: int, angle, height, link):
    """K_even, Eq. 6."""
    links = link + 2.0 * link * sum(jnp.cos(i * angle) for i in range(1, (count - 2) // 2 + 1))
    return links + 2.0 * height * sum(jnp.cos((2 * i - 1) / 2.0 * angle) for i in range(1, count // 2 + 1))


def state_of(robot: QuaternionArm, arm: VirtualArm) -> Float[Array, "segments 2"]:
    """Bends of a virtual arm anchored at the base, Fig. 4f: each Z_e seen from the frame of its segment's base."""
    rotation, bends = jnp.eye(3, dtype=arm.ends.dtype), []
    for count, direction in zip(robot.joints_per_segment, arm.end_directions, strict=True):
        local = rotation.T @ direction
        across = safe_norm(local[:2])
        angle = jnp.arctan2(across, local[2]) / count
        bends.append(jnp.sin(angle / 2.0) * local[:2] / jnp.maximum(across, _TINY))
        rotation = rotation @ jnp.linalg.matrix_power(joint_transform(robot, bends[-1])[1], count)
    return jnp.stack(bends)


def tip_x_axis(robot: QuaternionArm, bends: Float[Array, "segments 2"]) -> Float[Array, "3"]:
    """X_end: the first column of the tip's rotation."""
    rotation = jnp.eye(3, dtype=bends.dtype)
    for count, bend in zip(robot.joints_per_segment, bends, strict=True):
        rotation = rotation @ jnp.linalg.matrix_power(joint_transform(robot, bend)[1], count)
    return rotation[:, 0]


def angle_between(a: Float[Array, "3"], b: Float[Array, "3"]) -> Float[Array, ""]:
    """Angle of two directions [rad]; the arccos of Eqs. 10 and 13, without its loss of digits near 0."""
    return jnp.arctan2(safe_norm(jnp.cross(a, b)), jnp.dot(a, b))


def stack(rows: list[VirtualArm]) -> VirtualArm:
    """One virtual arm of its segments."""
    return jax.tree.map(lambda *values: jnp.stack(values), *rows)


SMALLEST_GAP = 1e-3
"""m theta stays this far below 180 degrees [rad]: l_1 and l_2 stay below some hundred arm lengths."""
_TINY = 1e-12
