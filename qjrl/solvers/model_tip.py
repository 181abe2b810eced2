"""A learned forward model as the robot that damped least squares descends on: its poses, the closed form's Jacobian.

Sag and stretch move the tip by millimetres and its derivative by a few percent, so steps along the closed form's Jacobian
still shrink the error tenfold each, and an iteration costs one pass through the network instead of one a coordinate.
Where an error remains, that Jacobian does not say which pose is the nearest: there the model's own is used.
"""

import dataclasses
from collections.abc import Callable

import jax
from jaxtyping import Array, Float

from qjrl.geometry.pose import rotation_of
from qjrl.robot.kinds import kind_of
from qjrl.robot.pose_model import PoseFunction
from qjrl.robot.tip import Tip, tip_by_differentiation
from qjrl.robot.verbs import Robot, cable_lengths

TipFunction = Callable[[Robot, Float[Array, "coordinates batch"]], Tip]


def nominal_tip(robot: Robot, coordinates: jax.Array) -> Tip:
    """The closed form's tip and Jacobian."""
    return kind_of(robot).tip_of(robot, coordinates)


def tip_function(model: PoseFunction | None) -> TipFunction:
    """The function (robot, coordinates) -> tip of a model `lengths -> pose`; None: the closed form.

    The coordinates are those whose cable lengths are commanded.
    """
    if model is None:
        return nominal_tip

    def tip(robot: Robot, coordinates: jax.Array) -> Tip:
        pose = jax.vmap(lambda one: model(lengths_of(robot, one)), in_axes=-1, out_axes=-1)(coordinates)
        rotation = jax.vmap(rotation_of, in_axes=-1, out_axes=-1)(pose)
        return dataclasses.replace(nominal_tip(robot, coordinates), position=pose[:3], rotation=rotation)

    return tip


def exact_tip_function(model: PoseFunction | None) -> TipFunction:
    """As `tip_function`, with the model's own Jacobian, one pass through it for every coordinate."""
    if model is None:
        return nominal_tip
    return lambda robot, coordinates: tip_by_differentiation(lambda one: model(lengths_of(robot, one)), coordinates)


def lengths_of(robot: Robot, coordinates: Float[Array, "coordinates"]) -> Float[Array, "cables"]:
    """Cable lengths [m] of the coordinates of a configuration."""
    return cable_lengths(robot, kind_of(robot).configuration_of(robot, coordinates))
