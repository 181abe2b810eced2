"""A Gaussian process as a forward model: it corrects the nominal configuration, or the nominal pose, and says how sure it is.

It computes in float64 whatever the precision of the lengths, and answers in theirs.
"""

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from scipy.stats import norm

from qjrl.config import Range, configuration
from qjrl.geometry.pose import position_of, row_errors
from qjrl.learning.gaussian_process import posterior
from qjrl.learning.gaussian_process.fit import FitReport, ProcessConfig, fit_process
from qjrl.learning.gaussian_process.hyperparameters import Hyperparameters
from qjrl.learning.gaussian_process.posterior import GaussianProcess
from qjrl.learning.gaussian_process.rows import Scaling
from qjrl.robot.model_coordinates import Rows, model_inputs, model_pose, model_targets
from qjrl.robot.model_kind import ModelKind, num_numbers
from qjrl.robot.model_uncertainty import QUANTITIES, PoseEstimate, coverage
from qjrl.robot.pose_coding import PoseCoding, decode, encode
from qjrl.robot.pose_model import ClosedForm
from qjrl.robot.tip import tip_by_differentiation
from qjrl.robot.verbs import Robot

NAMES = ("inputs", "targets", "weights", "hyperparameters", "scaling")
"""Of what a file must hold; the Cholesky factor, as large as all else many times over, is made again from them."""
LEVELS = (0.5, 0.9, 0.95)
"""What the intervals promise whose coverage is measured."""


@configuration
class GaussianProcessModelConfig(ProcessConfig):
    """Group `forward_model` with kind=gaussian_process. All values ours."""

    kind: Literal["gaussian_process"] = dataclasses.field(default="gaussian_process", kw_only=True)
    """Of the model."""
    inputs: Literal["configuration", "configuration_and_tip"] = "configuration"
    """What goes in: the nominal configuration of the cables, with or without the nominal position of the tip."""
    coding: Literal["configuration", PoseCoding] = "configuration"
    """What comes out: the correction of the configuration, or that of the pose in the codings of `pose_coding`; "configuration"
    is "split" for robots that do not sense theirs."""
    max_rows: Annotated[int, Range(10, 5000)] = 2000
    """Rows that the fit uses, the first of those not held out: time grows with their cube, memory with their square."""
    held_out: Annotated[float, Range(above=0.0, high=0.5)] = 0.1
    """Share of the rows that the fit never sees; errors are reported on them."""


@struct.dataclass
class GaussianProcessModel:
    """A fitted process of one robot."""

    process: GaussianProcess
    config: GaussianProcessModelConfig = struct.field(pytree_node=False)


@struct.dataclass(eq=False)
class GaussianProcessPose:
    """A fitted process on its robot."""

    robot: Any
    process: GaussianProcess
    inputs: str = struct.field(pytree_node=False)
    coding: str = struct.field(pytree_node=False)

    def __call__(self, lengths: jax.Array) -> jax.Array:
        """Pose (9,) at cable lengths (num_cables,) [m]."""
        answer = posterior.mean(self.process, process_inputs(self.robot, self.inputs, lengths))
        return corrected_pose(self.robot, self.coding, lengths, answer.astype(lengths.dtype))


@struct.dataclass(eq=False)
class EstimatedGaussianProcessPose:
    """A fitted process on its robot that says how sure it is; a pytree that is called, as its mean is."""

    mean: GaussianProcessPose

    def __call__(self, lengths: jax.Array) -> PoseEstimate:
        """Pose (9,) at cable lengths (num_cables,) [m], with the standard deviations of what is measured there."""
        model = self.mean
        answer, variance = answer_and_variance(model, lengths)
        answer, variance = answer.astype(lengths.dtype), variance.astype(lengths.dtype)
        pose = corrected_pose(model.robot, model.coding, lengths, answer)
        slopes = tip_by_differentiation(lambda one: corrected_pose(model.robot, model.coding, lengths, one), answer)
        sigmas = [jnp.sqrt(jnp.sum(slope**2 @ variance) / 3) for slope in (slopes.velocity, slopes.angular_velocity)]
        return PoseEstimate(pose, *sigmas)


def on_robot(robot: Robot, model: GaussianProcessModel) -> GaussianProcessPose:
    """The model as it is called, with no more than its mean needs."""
    return GaussianProcessPose(robot, posterior.mean_only(model.process), model.config.inputs, model.config.coding)


def pose_and_sigma(robot: Robot, model: GaussianProcessModel) -> EstimatedGaussianProcessPose:
    """What is called with lengths (num_cables,) [m] and answers a pose with its uncertainty."""
    return EstimatedGaussianProcessPose(
        GaussianProcessPose(robot, model.process, model.config.inputs, model.config.coding)
    )


def process_inputs(robot: Robot, inputs: str, lengths: jax.Array) -> jax.Array:
    """What enters the process at cable lengths (num_cables,) [m]."""
    nominal = model_inputs(robot, "corrected", lengths)
    if inputs == "configuration":
        return nominal
    return jnp.concatenate([nominal, position_of(ClosedForm(robot)(lengths))])


def process_targets(robot: Robot, coding: str, data: Rows) -> jax.Array:
    """What the process shall answer for rows of a data set: (n, outputs)."""
    if coding == "configuration":
        return model_targets(robot, "corrected", data)
    return _codes(robot, coding, jnp.asarray(data["cable_lengths"]), jnp.asarray(data["pose"]))


@functools.partial(jax.jit, static_argnums=1)
def _codes(robot: Any, coding: str, lengths: jax.Array, poses: jax.Array) -> jax.Array:
    return jax.vmap(lambda one, pose: encode(coding, ClosedForm(robot)(one), pose))(lengths, poses)


@functools.partial(jax.jit, static_argnums=1)
def _input_rows(robot: Any, inputs: str, lengths: jax.Array) -> jax.Array:
    return jax.vmap(lambda one: process_inputs(robot, inputs, one))(lengths)


def corrected_pose(robot: Robot, coding: str, lengths: jax.Array, answer: jax.Array) -> jax.Array:
    """Pose (9,) of the process's answer at cable lengths (num_cables,) [m]."""
    if coding == "configuration":
        return model_pose(robot, "corrected", lengths, answer)
    return decode(coding, ClosedForm(robot)(lengths), answer)


def fit_gaussian_process(
    robot: Robot, config: GaussianProcessModelConfig, split: tuple[Rows, Rows], seed: int, directory: Path
) -> tuple[GaussianProcessModel, dict[str, Any]]:
    """Fit the first `max_rows` rows of a split, and measure on its second part how often the intervals hold.

    Raises:
        ConfigError: fewer than ten rows.
    """
    del seed, directory  # nothing is drawn, and nothing is kept on the way
    train, held_out = split
    used = {name: column[: config.max_rows] for name, column in train.items()}
    inputs = _input_rows(robot, config.inputs, jnp.asarray(used["cable_lengths"]))
    process, reports = fit_process(config, np.asarray(inputs), np.asarray(process_targets(robot, config.coding, used)))
    model = GaussianProcessModel(process, config)
    count = len(used["seed"])
    about = {
        "rows": {"fitted": count, "beyond_max_rows": len(train["seed"]) - count},
        "process": _about(process, reports),
        "uncertainty": measured_uncertainty(robot, model, held_out),
    }
    return model, about


def measured_uncertainty(robot: Robot, model: GaussianProcessModel, data: Rows) -> dict[str, Any]:
    """On rows of a data set: median standard deviations of position [mm] and rotation [deg] and coverage [%] of their intervals,
    taken as equal along the axes, and coverage of the outputs' own intervals."""
    estimated = pose_and_sigma(robot, model)
    lengths = jnp.asarray(data["cable_lengths"])
    estimate, answers, variances = _estimates(estimated, lengths)
    found: dict[str, Any] = {}
    units = {"position": ("mm", 1e3), "orientation": ("deg", np.degrees(1.0))}
    for quantity, error in zip(QUANTITIES, row_errors(estimate.pose, data["pose"]), strict=True):
        sigma, (unit, factor) = np.asarray(getattr(estimate, f"{quantity}_sigma")), units[quantity]
        median = {f"median_sigma_{unit}": factor * float(np.median(sigma))}
        found[quantity] = median | _named(coverage(sigma, error, LEVELS))
    off = np.abs(answers - process_targets(robot, model.config.coding, data)) / np.sqrt(variances)
    found["outputs"] = _named([np.mean(off <= norm.ppf(0.5 + level / 2.0)) for level in LEVELS])
    return found


@jax.jit
def _estimates(model: EstimatedGaussianProcessPose, lengths: jax.Array) -> tuple[PoseEstimate, jax.Array, jax.Array]:
    return jax.lax.map(lambda one: (model(one), *answer_and_variance(model.mean, one)), lengths, batch_size=256)


def answer_and_variance(model: GaussianProcessPose, lengths: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Mean and variance (outputs,) of what is measured at cable lengths (num_cables,) [m]."""
    at = process_inputs(model.robot, model.inputs, lengths)
    answer, variance = posterior.mean_and_variance(model.process, at)
    return answer, variance + posterior.noise_variance(model.process)


def _named(shares: Any) -> dict[str, float]:
    return {
        f"coverage_{100 * level:g}_percent": 100.0 * float(share) for level, share in zip(LEVELS, shares, strict=True)
    }


def _about(process: GaussianProcess, reports: list[FitReport]) -> dict[str, Any]:
    """What the fit found, a value for each group of outputs that share it."""
    found = {name: np.asarray(value).tolist() for name, value in vars(process.hyperparameters).items()}
    told = {field.name: [getattr(report, field.name) for report in reports] for field in dataclasses.fields(FitReport)}
    return found | told


def process_to_arrays(process: GaussianProcess) -> dict[str, Any]:
    """Rows, weights, hyperparameters and scaling; no Cholesky factor."""
    nested = {name: vars(getattr(process, name)) for name in ("hyperparameters", "scaling")}
    return jax.tree.map(np.asarray, {name: nested.get(name, getattr(process, name)) for name in NAMES})


def process_from_arrays(kernel: str, arrays: Mapping[str, Any]) -> GaussianProcess:
    """The process of what `process_to_arrays` gave."""
    hyperparameters, scaling = Hyperparameters(**arrays["hyperparameters"]), Scaling(**arrays["scaling"])
    inputs, targets, weights = (arrays[name] for name in ("inputs", "targets", "weights"))
    factors = posterior.factors_of(kernel, hyperparameters, inputs)
    process = GaussianProcess(inputs, targets, weights, factors, hyperparameters, scaling, kernel)
    return jax.tree.map(jnp.asarray, process)


def to_arrays(model: GaussianProcessModel) -> dict[str, Any]:
    """Those of its process."""
    return process_to_arrays(model.process)


def from_arrays(config: GaussianProcessModelConfig, arrays: Mapping[str, Any]) -> GaussianProcessModel:
    """The model of what `to_arrays` gave."""
    return GaussianProcessModel(process_from_arrays(config.kernel, arrays), config)


GAUSSIAN_PROCESS = ModelKind(
    config=GaussianProcessModelConfig,
    fit=fit_gaussian_process,
    on_robot=on_robot,
    to_arrays=to_arrays,
    from_arrays=from_arrays,
    names=NAMES,
    size=lambda model: num_numbers(to_arrays(model)),
)
