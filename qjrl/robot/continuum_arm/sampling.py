"""Bends from uniform numbers: angle and direction of every segment each evenly, as the paper's commands are drawn."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qjrl.robot.at_distance import scaled_to_distance
from qjrl.robot.continuum_arm.arm import ContinuumArm
from qjrl.robot.continuum_arm.kinematics import forward_kinematics


def bends_from_unit_cube(arm: ContinuumArm, numbers: Float[Array, "bends"]) -> Float[Array, "segments 2"]:
    """Bends with theta even in [0, limit] and alpha even, from numbers in [0, 1)."""
    angle, turn = numbers.reshape(arm.num_segments, 2).T
    direction = jnp.stack([jnp.cos(2.0 * jnp.pi * turn), jnp.sin(2.0 * jnp.pi * turn)], axis=1)
    return (arm.bend_limit * angle)[:, None] * direction


def uniform_bends(arm: ContinuumArm, key: jax.Array) -> Float[Array, "segments 2"]:
    """Random bends of the same law."""
    return bends_from_unit_cube(arm, jax.random.uniform(key, (2 * arm.num_segments,)))


def planar_bends(arm: ContinuumArm, numbers: Float[Array, "bends"]) -> Float[Array, "segments 2"]:
    """Bends all in one plane, angles of both signs: the boundary of what the arm reaches lies there."""
    angle = arm.bend_limit * (2.0 * numbers[: arm.num_segments] - 1.0)
    return jnp.stack([angle, jnp.zeros_like(angle)], axis=1)


def bends_at_distance(arm: ContinuumArm, key: jax.Array, distance: Float[Array, ""]) -> Float[Array, "segments 2"]:
    """Bends in a random direction of bend space, as large as brings the tip `distance` [m] away from its home."""
    direction = jax.random.normal(key, (arm.num_segments, 2))
    largest = direction * arm.bend_limit / jnp.max(jnp.linalg.norm(direction, axis=1))
    return scaled_to_distance(lambda bends: forward_kinematics(arm, bends), largest, distance)
