"""Cables and strands of the arm: lengths from bends, and the closed-form inverse (paper 000, Eq. 16 completed).

Cables and strands are ordered by segment, then by hole: cable 2k + i is hole i of segment k; strands 2c and 2c + 1
are the two strands of cable c, at the hole angle and opposite to it.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.joint import joint_height


def cable_lengths(arm: QuaternionArm, bends: Float[Array, "segments 2"]) -> Float[Array, "cables"]:
    """Cable lengths relative to home, + pays out [m]: half the difference of each loop's strands.

    Linear in the bends and exact for both joint models, since the height H cancels in the difference. The cables of
    segment k cross every segment j <= k (paper 000, Eq. 16, prints the own segment alone and the opposite sign).
    """
    return cable_matrix(arm) @ bends.reshape(-1)


def bends_from_cables(arm: QuaternionArm, lengths: Float[Array, "cables"]) -> Float[Array, "segments 2"]:
    """Bends whose cable lengths [m] are given: the nominal forward kinematics of the cables, closed form.

    The two cables of segment k see the sum of m_j a_j over j <= k, so a 2x2 inverse and a difference give a_k.
    """
    directions = _hole_directions(arm).reshape(arm.num_segments, 2, 2)  # (segment, hole, xy)
    pairs = lengths.reshape(arm.num_segments, 2)
    determinant = directions[:, 0, 0] * directions[:, 1, 1] - directions[:, 0, 1] * directions[:, 1, 0]
    x = directions[:, 1, 1] * pairs[:, 0] - directions[:, 0, 1] * pairs[:, 1]
    y = directions[:, 0, 0] * pairs[:, 1] - directions[:, 1, 0] * pairs[:, 0]
    sums = -jnp.stack([x, y], axis=1) / (arm.hole_circle_diameter * determinant)[:, None]
    return jnp.diff(sums, axis=0, prepend=jnp.zeros((1, 2), sums.dtype)) / jnp.array(arm.joints_per_segment)[:, None]


def cable_matrix(arm: QuaternionArm) -> Float[Array, "cables bends"]:
    """The block-triangular map from bends to cable lengths [m]."""
    directions = _hole_directions(arm).reshape(arm.num_segments, 2, 2)  # (segment, hole, xy)
    rows = [
        jnp.concatenate(
            [
                -arm.hole_circle_diameter * arm.joints_per_segment[j] * directions[k] * (1.0 if j <= k else 0.0)
                for j in range(arm.num_segments)
            ],
            axis=1,
        )
        for k in range(arm.num_segments)
    ]
    return jnp.concatenate(rows)


def strand_lengths(arm: QuaternionArm, bends: Float[Array, "segments 2"]) -> Float[Array, "strands"]:
    """Length of every strand inside the joints it crosses, sum over j <= k of m_j [H(theta_j) -/+ D (cos b, sin b) a_j] [m].

    Holds the common part of a loop's two strands too, which a motor cannot give: zero relative to home for the
    spherical joint, stretch or slack for the rolling one.
    """
    differences = cable_lengths(arm, bends)
    return (common_lengths(arm, bends)[:, None] + jnp.stack([differences, -differences], axis=1)).reshape(-1)


def common_lengths(arm: QuaternionArm, bends: Float[Array, "segments 2"]) -> Float[Array, "cables"]:
    """Mean length of each loop's two strands inside the joints they cross [m]."""
    heights = jax.vmap(lambda bend: joint_height(arm, bend))(bends) * jnp.array(arm.joints_per_segment)
    return jnp.repeat(jnp.cumsum(heights), 2)


def strand_commands(arm: QuaternionArm, lengths: Float[Array, "cables"]) -> Float[Array, "strands"]:
    """Rest lengths that the motors give the strands for cable lengths [m]: home +/- length, less the pretension's stretch."""
    home = strand_lengths(arm, jnp.zeros((arm.num_segments, 2)))
    signed = jnp.stack([lengths, -lengths], axis=1).reshape(-1)
    return home + signed - arm.pretension / arm.strand_stiffness


def cable_strokes(arm: QuaternionArm) -> Float[Array, "cables"]:
    """Largest |cable length| over all bends within the bend limit [m]."""
    reach = arm.hole_circle_diameter * jnp.sin(arm.bend_limit / 2.0) * jnp.array(arm.joints_per_segment)
    return jnp.repeat(jnp.cumsum(reach), 2)


def _hole_directions(arm: QuaternionArm) -> Float[Array, "cables 2"]:
    angles = arm.hole_angles.reshape(-1)
    return jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
