"""The covariance of the rows that a process was given, and its Cholesky factor, on the host in float64."""

from typing import Any

import numpy as np
from scipy.linalg import cholesky

from qjrl.learning.gaussian_process.hyperparameters import Hyperparameters
from qjrl.learning.gaussian_process.kernels import KERNELS, squared_distances

JITTER = 1e-9
"""Share of the signal's variance that is added to the diagonal, so that rows that coincide can be factorised."""


def covariance_between(kernel: str, hyperparameters: Hyperparameters, one: Any, other: Any) -> Any:
    """Covariance of the function at rows (..., inputs) and (n, inputs), standardised: (..., n)."""
    scales = hyperparameters.length_scales
    squared = squared_distances(one / scales, other / scales)
    return hyperparameters.signal**2 * KERNELS[kernel].value(squared, hyperparameters.shape)


def diagonal_addition(hyperparameters: Hyperparameters) -> Any:
    """What the diagonal of the covariance of measurements has beside the function's: noise and jitter."""
    return hyperparameters.noise**2 + JITTER * hyperparameters.signal**2


def measured_covariance(kernel: str, hyperparameters: Hyperparameters, inputs: np.ndarray) -> np.ndarray:
    """Covariance (n, n) of measurements at rows (n, inputs), standardised."""
    covariance = covariance_between(kernel, hyperparameters, inputs, inputs)
    np.einsum("ii->i", covariance)[:] = hyperparameters.signal**2 + diagonal_addition(hyperparameters)
    return covariance


def factor(covariance: np.ndarray) -> np.ndarray:
    """L (n, n), lower, with L L^T the covariance.

    Raises:
        LinAlgError: it is not positive definite.
    """
    return cholesky(covariance, lower=True, check_finite=False)
