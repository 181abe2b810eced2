"""Bends from uniform numbers: evenly over the feasible discs, evenly in angle, in one plane, and at a distance from home."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qjrl.robot.at_distance import scaled_to_distance
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.joint import bends_from_angles
from qjrl.robot.quaternion_arm.kinematics import forward_kinematics

# Planar angles are drawn up to this many limits.
_BEYOND = 1.2


def bends_from_unit_cube(arm: QuaternionArm, numbers: Float[Array, "bends"]) -> Float[Array, "segments 2"]:
    """Bends evenly over each segment's disc |a| <= sin(limit/2), from numbers in [0, 1): for data sets."""
    radial, turn = numbers.reshape(arm.num_segments, 2).T
    radius = jnp.sin(arm.bend_limit / 2.0) * jnp.sqrt(radial)
    return radius[:, None] * jnp.stack([jnp.cos(2 * jnp.pi * turn), jnp.sin(2 * jnp.pi * turn)], axis=1)


def uniform_bends(arm: QuaternionArm, key: jax.Array) -> Float[Array, "segments 2"]:
    """Bends with theta uniform in [0, limit] and phi uniform: the paper's law of test poses (section 5.2)."""
    key_angle, key_direction = jax.random.split(key)
    angle = jax.random.uniform(key_angle, (arm.num_segments,)) * arm.bend_limit
    direction = jax.random.uniform(key_direction, (arm.num_segments,)) * 2 * jnp.pi
    return bends_from_angles(direction, angle)


def planar_bends(
    arm: QuaternionArm, numbers: Float[Array, "segments"], azimuth: Float[Array, ""]
) -> Float[Array, "segments 2"]:
    """Bends all in the plane through the base axis at `azimuth` [rad], angles of both signs, from numbers in [0, 1).

    The boundary of what a symmetric arm reaches lies on planar poses, so that they find it long before others do.
    Angles are drawn up to 1.2 limits and held at the limit: one in six lies on it, where the rim is.
    """
    angle = arm.bend_limit * jnp.clip(_BEYOND * (2.0 * numbers - 1.0), -1.0, 1.0)
    return bends_from_angles(jnp.broadcast_to(azimuth, angle.shape), angle)


def bends_at_distance(arm: QuaternionArm, key: jax.Array, distance: Float[Array, ""]) -> Float[Array, "segments 2"]:
    """Bends in a random direction of bend space, scaled until the tip is `distance` [m] away from its home.

    Where the direction's longest feasible bends do not reach so far, those are returned.
    """
    direction = jax.random.normal(key, (arm.num_segments, 2))
    largest = direction * jnp.sin(arm.bend_limit / 2.0) / jnp.max(jnp.linalg.norm(direction, axis=1))
    return scaled_to_distance(lambda bends: forward_kinematics(arm, bends), largest, distance)
