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
from qjrl.robot.forward_model import ForwardModel, make_network, model_inputs, model_pose, pose_function
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


def pose_and_sigma(robot: Robot, model: ForwardModel) -> Callable[[jax.Array], PoseEstimate]:
    """The plain function lengths (num_cables,) [m] -> pose with its uncertainty, calibrated as far as the model is.

    Raises:
        ValueError: the model is a single network.
    """
    if model.config.ensemble == 1:
        raise ValueError("ensemble: got 1, allowed: 2 or more for an uncertainty")
    form, network, mean_pose = model.config.form, make_network(robot, model.config), pose_function(robot, model)
    factors = jnp.ones(2) if model.sigma_factors is None else jnp.asarray(model.sigma_factors)

    def estimate(lengths: jax.Array) -> PoseEstimate:
        answers = predict_members(network, model.fitted, model_inputs(robot, form, lengths))
        poses = jax.vmap(lambda answer: model_pose(robot, form, lengths, answer))(answers)
        pose = mean_pose(lengths)
        position, orientation = (_spread(error, poses, pose) for error in (position_error, orientation_error))
        return PoseEstimate(pose, factors[0] * position, factors[1] * orientation)

    return estimate


def calibrate(
    robot: Robot, model: ForwardModel, data: Mapping[str, np.ndarray]
) -> tuple[ForwardModel, dict[str, Any], dict[str, np.ndarray]]:
    """Fit the factors to every second row of a data set that no fit has seen, and report on the others.

    Returns:
        The model with its factors; by quantity the factor, the measured coverage [%] of the 90 % intervals and the
        coverage curve; and position and orientation errors and sigmas (n,) [m], [rad] of the rows reported on.
    """
    function = jax.jit(jax.vmap(pose_and_sigma(robot, dataclasses.replace(model, sigma_factors=None))))
    estimate = function(jnp.asarray(data["cable_lengths"]))
    factors, report, evaluated = [], {}, {}
    for quantity, error in zip(QUANTITIES, row_errors(estimate.pose, data["pose"]), strict=True):
        sigma = np.asarray(getattr(estimate, f"{quantity}_sigma"))
        factor = sigma_factor(sigma[::2], error[::2])
        evaluated |= {f"{quantity}_error": error[1::2], f"{quantity}_sigma": factor * sigma[1::2]}
        report[quantity] = {"factor": factor} | _coverages(factor * sigma[1::2], error[1::2])
        factors.append(factor)
    return dataclasses.replace(model, sigma_factors=jnp.asarray(factors)), report, evaluated


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
