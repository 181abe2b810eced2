"""How sure an ensemble is of its pose: the spread of its members, scaled until its intervals hold what they promise.

The errors of position and of orientation are taken as three independent normal numbers of one standard deviation,
so that the error over that deviation follows the chi distribution of three degrees of freedom. The members' spread
underestimates what all of them miss alike; one factor for each of the two makes up for that, fitted to held-out rows.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from scipy.stats import chi

from qjrl.geometry.pose import orientation_error, position_error, row_errors
from qjrl.learning.fitting import predict_members
from qjrl.robot.model_coordinates import model_inputs, model_pose
from qjrl.robot.network_model import NetworkModel, NetworkPose, on_robot
from qjrl.robot.verbs import Robot

QUANTITIES = ("position", "orientation")
LEVEL = 0.9
"""Share of the errors by which the factors are chosen."""
_SMALLEST = 1e-12  # [m], [rad]: members that agree to the last bit are still not certain


@struct.dataclass
class PoseEstimate:
    """A pose, and standard deviations of its error along one axis."""

    pose: Any
    """(9,)."""
    position_sigma: Any
    """() [m]."""
    orientation_sigma: Any
    """() [rad]."""


@struct.dataclass(eq=False)
class EstimatedPose:
    """An ensemble on its robot that says how sure it is; a pytree that is called, as its mean is."""

    mean: NetworkPose
    factors: Any
    """(2,) of position and orientation."""

    def __call__(self, lengths: jax.Array) -> PoseEstimate:
        """Pose (9,) at cable lengths (num_cables,) [m], with its uncertainty."""
        robot, form = self.mean.robot, self.mean.form
        answers = predict_members(self.mean.network, self.mean.fitted, model_inputs(robot, form, lengths))
        poses = jax.vmap(lambda answer: model_pose(robot, form, lengths, answer))(answers)
        pose = self.mean(lengths)
        position, orientation = (_spread(error, poses, pose) for error in (position_error, orientation_error))
        return PoseEstimate(pose, self.factors[0] * position, self.factors[1] * orientation)


def pose_and_sigma(robot: Robot, model: NetworkModel) -> EstimatedPose:
    """What is called with lengths (num_cables,) [m] and answers a pose with its uncertainty, calibrated as far as the model is.

    Raises:
        ValueError: the model is a single network.
    """
    if model.config.ensemble == 1:
        raise ValueError("ensemble: got 1, allowed: 2 or more for an uncertainty")
    factors = jnp.ones(2) if model.sigma_factors is None else jnp.asarray(model.sigma_factors)
    return EstimatedPose(on_robot(robot, model), factors)


def calibrate(
    robot: Robot, model: NetworkModel, data: Mapping[str, np.ndarray]
) -> tuple[NetworkModel, dict[str, Any], dict[str, np.ndarray]]:
    """Fit the factors to every second row of a data set that no fit has seen, and report on the others.

    Returns:
        The model with its factors; by quantity the factor, the measured coverage [%] of the 90 % intervals and the
        coverage curve; and position and orientation errors and sigmas (n,) [m], [rad] of the rows reported on.
    """
    plain = pose_and_sigma(robot, dataclasses.replace(model, sigma_factors=None))
    estimate = _estimates(plain, jnp.asarray(data["cable_lengths"]))
    factors, report, evaluated = [], {}, {}
    for quantity, error in zip(QUANTITIES, row_errors(estimate.pose, data["pose"]), strict=True):
        sigma = np.asarray(getattr(estimate, f"{quantity}_sigma"))
        factor = sigma_factor(sigma[::2], error[::2])
        evaluated |= {f"{quantity}_error": error[1::2], f"{quantity}_sigma": factor * sigma[1::2]}
        report[quantity] = {"factor": factor} | _coverages(factor * sigma[1::2], error[1::2])
        factors.append(factor)
    return dataclasses.replace(model, sigma_factors=jnp.asarray(factors)), report, evaluated


@jax.jit
def _estimates(model: EstimatedPose, lengths: jax.Array) -> PoseEstimate:
    return jax.vmap(model)(lengths)


def _coverages(sigma: np.ndarray, error: np.ndarray) -> dict[str, Any]:
    levels, shares = coverage_curve(sigma, error)
    at_level = 100.0 * float(coverage(sigma, error, (LEVEL,))[0])
    return {"coverage_90_percent": at_level, "levels": levels.tolist(), "shares": shares.tolist()}


def sigma_factor(sigma: np.ndarray, error: np.ndarray, level: float = LEVEL) -> float:
    """What to multiply standard deviations (n,) by, so that a share `level` of the errors (n,) lies in its intervals."""
    return float(np.quantile(error / sigma, level) / chi.ppf(level, df=3))


def coverage(sigma: np.ndarray, error: np.ndarray, levels: Sequence[float] | np.ndarray) -> np.ndarray:
    """Share of the errors (n,) inside the intervals that promise the shares `levels`."""
    radii = chi.ppf(np.asarray(levels), df=3)
    return np.mean(error[:, None] <= sigma[:, None] * radii, axis=0)


def coverage_curve(sigma: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Promised and measured shares, from 5 to 99 %."""
    levels = np.array([*np.arange(0.05, 0.951, 0.05), 0.99])
    return levels, coverage(sigma, error, levels)


def _spread(error: Callable[[Any, Any], jax.Array], poses: jax.Array, mean: jax.Array) -> jax.Array:
    """Standard deviation along one axis of members' poses (members, 9) about their mean's pose (9,)."""
    distances = jax.vmap(lambda pose: error(pose, mean))(poses)
    return jnp.maximum(jnp.sqrt(jnp.sum(distances**2) / (3 * (len(poses) - 1))), _SMALLEST)
