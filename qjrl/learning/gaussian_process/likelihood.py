"""The log marginal likelihood of a process and its gradient, on the host in float64.

    L = -1/2 tr(Y^T K^-1 Y) - m/2 log det K - n m / 2 log 2 pi        of n rows and m outputs that share K
    dL/dp = 1/2 tr((A A^T - m K^-1) dK/dp),  A = K^-1 Y

The gradient by a length scale needs no matrix of its own: sum_jk G_jk (x_j - x_k)^2 is two products of G with the inputs.
Source: Rasmussen and Williams, Gaussian Processes for Machine Learning, equation 5.9.
"""

import math

import numpy as np
from scipy.linalg import get_lapack_funcs

from qjrl.learning.gaussian_process.covariance import diagonal_addition
from qjrl.learning.gaussian_process.hyperparameters import from_logs, num_logs
from qjrl.learning.gaussian_process.kernels import KERNELS, squared_distances

_factor, _solve, _invert = get_lapack_funcs(("potrf", "potrs", "potri"), dtype=np.float64)


def log_marginal_likelihood(
    kernel: str, logs: np.ndarray, inputs: np.ndarray, targets: np.ndarray
) -> tuple[float, np.ndarray]:
    """The likelihood and its gradient by the logarithms of the hyperparameters.

    Args:
        kernel: a key of `KERNELS`.
        logs: as `from_logs` takes them.
        inputs: (n, d).
        targets: (n, m), outputs that share the hyperparameters.
    Returns:
        The value, and the gradient of the form of `logs`. Where the covariance is not positive definite -inf, and zeros.
    """
    found, (count, num_outputs) = from_logs(kernel, logs, inputs.shape[1]), targets.shape
    scaled = inputs / found.length_scales
    squared = squared_distances(scaled, scaled)
    value, slope = KERNELS[kernel].with_slope(squared, found.shape)
    covariance = found.signal**2 * value
    covariance.flat[:: count + 1] = found.signal**2 + diagonal_addition(found)
    # The transpose of a symmetric matrix in rows is itself in columns, which LAPACK takes without a copy.
    lower, failed = _factor(covariance.T, lower=1, clean=1, overwrite_a=1)
    if failed:
        return -math.inf, np.zeros(len(logs))
    weights = _solve(lower, targets, lower=1)[0]
    log_determinant = 2.0 * np.sum(np.log(np.diagonal(lower)))
    fit = np.sum(targets * weights)
    likelihood = -0.5 * (fit + num_outputs * log_determinant + targets.size * math.log(2.0 * math.pi))
    inverse = _invert(lower, lower=1, overwrite_c=1)[0].T  # upper triangle in rows, zeros below
    inverse *= -num_outputs
    inverse += weights @ weights.T  # of which the upper triangle counts
    by_covariance = np.triu(inverse)
    trace = np.trace(by_covariance)
    np.fill_diagonal(by_covariance, 0.0)  # the other slopes are between rows alone
    slope *= by_covariance
    slope *= found.signal**2
    parts = [
        _by_length_scales(slope, scaled, len(logs) - num_logs(kernel, 0)),
        [fit - targets.size - trace * found.noise**2],  # sum of W K less the noise's part
        [trace * found.noise**2],
    ]
    if (shape_slope := KERNELS[kernel].shape_slope) is not None:
        by_shape = np.vdot(by_covariance, shape_slope(squared, found.shape))
        parts.append([found.signal**2 * found.shape * by_shape])
    return float(likelihood), np.concatenate(parts)


def _by_length_scales(by_squared: np.ndarray, scaled: np.ndarray, num_scales: int) -> np.ndarray:
    """Gradient by the logarithms, from that by the squared distances above the diagonal (n, n): -2 sum G_jk (x_j - x_k)^2."""
    sums = np.sum(by_squared, axis=0) + np.sum(by_squared, axis=1)
    crossed = np.sum(scaled * (by_squared @ scaled), axis=0)
    gradient = -2.0 * (sums @ scaled**2 - 2.0 * crossed)
    return gradient if num_scales == len(gradient) else np.sum(gradient, keepdims=True)
