"""The grey model, and the grey model with a Gaussian process on what it leaves, as forward models of the continuum arm."""

import dataclasses
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.config import Range, configuration
from qjrl.geometry.pose import position_of
from qjrl.learning.gaussian_process import posterior
from qjrl.learning.gaussian_process.fit import ProcessConfig, fit_process
from qjrl.learning.gaussian_process.posterior import GaussianProcess
from qjrl.robot.continuum_arm.grey import GreyNumbers, grey_pose
from qjrl.robot.continuum_arm.grey_fit import FittedGrey, fit_grey, rubbing_of_rows
from qjrl.robot.gaussian_process_model import process_from_arrays, process_to_arrays
from qjrl.robot.model_coordinates import Rows, model_inputs
from qjrl.robot.model_errors import pose_errors
from qjrl.robot.model_kind import ModelKind, num_numbers
from qjrl.robot.pose_coding import decode, encode
from qjrl.robot.verbs import Robot

KINDS_OF_ROBOTS = ("continuum_arm",)


@configuration
class GreyConfig:
    """Group `forward_model` with kind=grey. All values ours."""

    kind: Literal["grey"] = "grey"
    """Of the model."""
    held_out: Annotated[float, Range(above=0.0, high=0.5)] = 0.1
    """Share of the rows that the fit never sees; errors are reported on them."""


@configuration
class GreyProcessConfig(ProcessConfig):
    """Group `forward_model` with kind=grey_gaussian_process. All values ours."""

    kind: Literal["grey_gaussian_process"] = dataclasses.field(default="grey_gaussian_process", kw_only=True)
    """Of the model."""
    inputs: Literal["configuration", "configuration_and_tip"] = "configuration"
    """What enters the process: the nominal bends, with or without the position of the grey model's tip."""
    max_rows: Annotated[int, Range(10, 5000)] = 2000
    """Rows that the process is given, the first of those not held out."""
    held_out: Annotated[float, Range(above=0.0, high=0.5)] = 0.1
    """Share of the rows that the fit never sees; errors are reported on them."""


@struct.dataclass
class GreyModel:
    """A fitted grey model of one arm."""

    grey: FittedGrey
    process: GaussianProcess | None
    """Of what it leaves; None: the grey model alone."""
    config: Any = struct.field(pytree_node=False)


@struct.dataclass(eq=False)
class GreyPose:
    """A fitted grey model on its arm. Which way its cables moved last is not said to it: friction counts as none."""

    robot: Any
    numbers: GreyNumbers
    process: GaussianProcess | None
    inputs: str = struct.field(pytree_node=False)

    is_chain = True

    def __call__(self, lengths: jax.Array) -> jax.Array:
        """Pose (9,) at cable lengths (num_cables,) [m]."""
        return self.after(lengths, None)

    def after(self, lengths: jax.Array, rubbing: jax.Array | None) -> jax.Array:
        """The same where it is known how the cables moved, see `grey.rubbing_of`."""
        pose = grey_pose(self.robot, self.numbers, lengths, rubbing)
        if self.process is not None:
            answer = posterior.mean(self.process, process_inputs(self.robot, self.inputs, lengths, pose))
            pose = decode("split", pose, answer)
        return pose.astype(lengths.dtype)


def process_inputs(robot: Robot, inputs: str, lengths: jax.Array, pose: jax.Array) -> jax.Array:
    """What enters the process: nominal bends as shares of the limit, and the tip of the grey model's pose [m]."""
    nominal = model_inputs(robot, "corrected", lengths)
    return nominal if inputs == "configuration" else jnp.concatenate([nominal, position_of(pose)])


def fit(
    robot: Any, config: Any, split: tuple[Rows, Rows], seed: int, directory: Path
) -> tuple[GreyModel, dict[str, Any]]:
    """Fit the numbers, and the process to what they leave; both know how each row's cables had moved.

    Returns:
        The model, and its errors on the rows held out with and without that knowledge.
    """
    del seed, directory
    train, held_out = split
    grey = fit_grey(robot, train)
    model = GreyModel(grey, None, config)
    if isinstance(config, GreyProcessConfig):
        used = {name: column[: config.max_rows] for name, column in train.items()}
        poses = poses_after(on_robot(robot, model), used)
        lengths = jnp.asarray(used["cable_lengths"])
        inputs = jax.jit(jax.vmap(partial(process_inputs, robot, config.inputs)))(lengths, poses)
        targets = jax.jit(jax.vmap(partial(encode, "split")))(poses, jnp.asarray(used["pose"]))
        process, _ = fit_process(config, np.asarray(inputs), np.asarray(targets))
        model = GreyModel(grey, process, config)
    about: dict[str, Any] = {"scatter_mm": 1e3 * float(grey.scatter)}
    if "previous_cable_lengths" in held_out:
        about["held_out_with_history"] = pose_errors(poses_after(on_robot(robot, model), held_out), held_out["pose"])
    return model, about


def poses_after(model: GreyPose, data: Mapping[str, np.ndarray]) -> jax.Array:
    """Poses (n, 9) at rows of a data set, of which it may be known what the cables held before."""
    return _poses_after(model, jnp.asarray(data["cable_lengths"]), rubbing_of_rows(model.robot, data))


@jax.jit
def _poses_after(model: GreyPose, lengths: jax.Array, rubbing: jax.Array) -> jax.Array:
    return jax.vmap(model.after)(lengths, rubbing)


def on_robot(robot: Robot, model: GreyModel) -> GreyPose:
    """The model as it is called."""
    process = None if model.process is None else posterior.mean_only(model.process)
    return GreyPose(robot, model.grey.numbers, process, getattr(model.config, "inputs", "configuration"))


def to_arrays(model: GreyModel) -> dict[str, Any]:
    """Numbers, covariance, scatter; and the process."""
    grey = {"numbers": vars(model.grey.numbers), "covariance": model.grey.covariance, "scatter": model.grey.scatter}
    arrays = {"grey": jax.tree.map(np.asarray, grey)}
    return arrays if model.process is None else arrays | {"process": process_to_arrays(model.process)}


def from_arrays(config: Any, arrays: Mapping[str, Any]) -> GreyModel:
    """The model of what `to_arrays` gave."""
    said = jax.tree.map(jnp.asarray, arrays["grey"])
    grey = FittedGrey(GreyNumbers(**said["numbers"]), said["covariance"], said["scatter"])
    process = process_from_arrays(config.kernel, arrays["process"]) if "process" in arrays else None
    return GreyModel(grey, process, config)


GREY = ModelKind(
    config=GreyConfig,
    fit=fit,
    on_robot=on_robot,
    to_arrays=to_arrays,
    from_arrays=from_arrays,
    names=("grey",),
    size=lambda model: num_numbers(model.grey.numbers),
    robots=KINDS_OF_ROBOTS,
)
GREY_GAUSSIAN_PROCESS = dataclasses.replace(
    GREY, config=GreyProcessConfig, names=("grey", "process"), size=lambda model: num_numbers(to_arrays(model))
)
