"""A learned forward model as the arm that damped least squares descends on: its poses, the closed form's Jacobian.

Sag and stretch move the tip by millimetres and its derivative by a few percent, so steps along the closed form's Jacobian
still shrink the error tenfold each, and an iteration costs one pass through the network instead of one a coordinate.
Where an error remains, that Jacobian does not say which pose is the nearest: there the model's own is used.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qjrl.geometry.pose import position_of, rotation_of
from qjrl.robot.forward_model import PoseFunction
from qjrl.robot.quaternion_arm.differential import Tip, tip_of
from qjrl.robot.quaternion_arm.joint import bend_from_vector
from qjrl.robot.verbs import Robot, cable_lengths

TipFunction = Callable[[Robot, Float[Array, "segments 2 batch"]], Tip]


def tip_function(model: PoseFunction | None) -> TipFunction:
    """The function (robot, bend vectors) -> tip of a model `lengths -> pose`; None: the closed form.

    The bend vectors are those whose cable lengths are commanded.
    """
    if model is None:
        return tip_of

    def tip(robot: Robot, vectors: jax.Array) -> Tip:
        pose = jax.vmap(lambda rows: model(lengths_of(robot, rows)), in_axes=-1, out_axes=-1)(vectors)
        rotation = jax.vmap(rotation_of, in_axes=-1, out_axes=-1)(pose)
        return dataclasses.replace(tip_of(robot, vectors), position=pose[:3], rotation=rotation)

    return tip


def exact_tip_function(model: PoseFunction | None) -> TipFunction:
    """As `tip_function`, with the model's own Jacobian, one pass through it for every coordinate."""
    if model is None:
        return tip_of

    def frame(robot: Robot, rows: jax.Array) -> tuple[jax.Array, jax.Array]:
        pose = model(lengths_of(robot, rows))
        return position_of(pose), rotation_of(pose)

    def tip_of_one(robot: Robot, rows: jax.Array) -> Tip:
        position, rotation = frame(robot, rows)
        velocity, rotation_rate = (
            rate.reshape(*rate.shape[:-2], -1) for rate in jax.jacfwd(lambda rows: frame(robot, rows))(rows)
        )
        turning = 0.5 * jnp.sum(jnp.cross(rotation[..., None], rotation_rate, axis=0), axis=1)  # columns r: r x dr/2
        return Tip(position, rotation, velocity, turning)

    return lambda robot, vectors: jax.vmap(tip_of_one, in_axes=(None, -1), out_axes=-1)(robot, vectors)


def lengths_of(robot: Robot, vectors: Float[Array, "segments 2"]) -> Float[Array, "cables"]:
    """Cable lengths [m] of bend vectors theta_k (cos phi_k, sin phi_k) [rad]."""
    return cable_lengths(robot, jax.vmap(bend_from_vector)(vectors))
