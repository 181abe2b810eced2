"""The functions that are exported: plain ones of a single sample, with the names, sizes and units of what goes in and out."""

import dataclasses
from collections.abc import Callable
from typing import Literal

import jax

from qjrl.robot import in_precision
from qjrl.robot.forward_model import pose_function
from qjrl.robot.model_kind import FittedModel
from qjrl.robot.verbs import Robot

Precision = Literal["float32", "float64"]
Outputs = dict[str, jax.Array]
SolveFunction = Callable[[jax.Array], Outputs]
"""Inverse kinematics for a controller: target (9,) -> the outputs of `INVERSE_OUTPUTS`; pure, of a fixed cost."""

POSE_NAMES = ("x", "y", "z", "xx", "xy", "xz", "yx", "yy", "yz")
"""Position, then the first and the second column of the rotation."""


@dataclasses.dataclass(frozen=True)
class Port:
    """One input or output of a sample."""

    name: str
    shape: tuple[int, ...]
    unit: str
    meaning: str
    dtype: str | None = None
    """None: the precision of the export."""


@dataclasses.dataclass(frozen=True)
class DeployedFunction:
    """One function to export."""

    name: str
    function: Callable[..., Outputs]
    """The inputs of one sample, in their order -> its outputs by name."""
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]


def forward_function(robot: Robot, model: FittedModel, precision: Precision) -> DeployedFunction:
    """Cable lengths -> pose under a fitted model; a network computes in float32 whatever the precision."""
    pose = pose_function(in_precision(robot, precision), model)
    return DeployedFunction(
        "forward_model", lambda lengths: {"pose": pose(lengths)}, (_lengths(robot),), (_pose("pose"),)
    )


def inverse_function(robot: Robot, solve: SolveFunction) -> DeployedFunction:
    """Target pose -> cable lengths, for any solver of the right signature."""
    outputs = (
        _lengths(robot),
        Port("position_error", (), "m", "predicted distance from the target"),
        Port("orientation_error", (), "rad", "predicted angle from the target"),
        Port("converged", (), "-", "both predicted errors are within the solver's tolerances", "bool"),
    )
    return DeployedFunction("inverse_kinematics", solve, (_pose("target"),), outputs)


def _lengths(robot: Robot) -> Port:
    return Port("cable_lengths", (robot.num_cables,), "m", "relative to home, + pays out; order: cables")


def _pose(name: str) -> Port:
    return Port(name, (9,), "m, -", "pose of the tip in the base frame; order: pose_names")
