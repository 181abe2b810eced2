"""A process that was given rows: the mean and the variance of its outputs elsewhere, of one input; callers vmap.

Outputs that share hyperparameters are a group with one Cholesky factor. All outputs are one group, or each is its own.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.scipy.linalg import solve_triangular
from scipy.linalg import cho_solve

from qjrl.learning.gaussian_process.covariance import covariance_between, factor, measured_covariance
from qjrl.learning.gaussian_process.hyperparameters import Hyperparameters
from qjrl.learning.gaussian_process.rows import Scaling, standardised_inputs, standardised_targets


@struct.dataclass
class GaussianProcess:
    """A process with a mean of zero in standardised units; a pytree of float64 arrays."""

    inputs: Any
    """(n, inputs), standardised."""
    targets: Any
    """(n, outputs), standardised."""
    weights: Any
    """(groups, n, outputs of a group): inverse covariance times targets."""
    cholesky: Any
    """(groups, n, n), lower; None where only the mean is asked for."""
    hyperparameters: Hyperparameters
    """Each with a leading axis of groups."""
    scaling: Scaling
    kernel: str = struct.field(pytree_node=False)


def condition(
    kernel: str, hyperparameters: Hyperparameters, scaling: Scaling, inputs: np.ndarray, targets: np.ndarray
) -> GaussianProcess:
    """The process that was given rows (n, inputs) and (n, outputs), in their own units.

    Args:
        hyperparameters: each with a leading axis of groups.
    Raises:
        LinAlgError: a covariance is not positive definite.
    """
    scaling = jax.tree.map(np.asarray, scaling)
    rows = standardised_inputs(scaling, inputs), standardised_targets(scaling, targets)
    return with_factors(kernel, hyperparameters, scaling, rows, factors_of(kernel, hyperparameters, rows[0]))


def factors_of(kernel: str, hyperparameters: Hyperparameters, inputs: np.ndarray) -> np.ndarray:
    """Cholesky factors (groups, n, n) of the covariances at standardised rows (n, inputs); raises as `condition`."""
    covariances = (measured_covariance(kernel, group, inputs) for group in groups_of(hyperparameters))
    return np.stack([factor(covariance) for covariance in covariances])


def with_factors(
    kernel: str,
    hyperparameters: Hyperparameters,
    scaling: Scaling,
    standardised: tuple[np.ndarray, np.ndarray],
    factors: np.ndarray,
) -> GaussianProcess:
    """The process of standardised rows and of the Cholesky factors (groups, n, n) of their covariances."""
    inputs, targets = standardised
    parts = np.split(targets, len(factors), axis=1)
    weights = np.stack([cho_solve((lower, True), part) for lower, part in zip(factors, parts, strict=True)])
    process = GaussianProcess(inputs, targets, weights, factors, hyperparameters, scaling, kernel)
    return jax.tree.map(jnp.asarray, process)


def groups_of(hyperparameters: Hyperparameters) -> list[Hyperparameters]:
    """Those of every group, on the host."""
    host = jax.tree.map(np.asarray, hyperparameters)
    return [jax.tree.map(lambda leaf, index=index: leaf[index], host) for index in range(len(host.signal))]


def on_host(process: GaussianProcess) -> GaussianProcess:
    """The process with NumPy's arrays: what rows are added to and chosen by."""
    return jax.tree.map(np.asarray, process)


def mean_only(process: GaussianProcess) -> GaussianProcess:
    """The process with no more than its mean needs."""
    return dataclasses.replace(process, cholesky=None, targets=None)


def mean(process: GaussianProcess, one: jax.Array) -> jax.Array:
    """Mean (outputs,) of what is measured at an input (inputs,), in the units of the targets."""
    return _in_units(process, _standardised_mean(process, _covariances(process, one)))


def mean_and_variance(process: GaussianProcess, one: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Mean and variance (outputs,) of the function at an input (inputs,); `noise_variance` comes on top where it is measured."""
    covariances = _covariances(process, one)
    solved = jax.vmap(lambda lower, right: solve_triangular(lower, right, lower=True))(process.cholesky, covariances)
    explained = jnp.sum(solved**2, axis=1)
    variance = jnp.maximum(process.hyperparameters.signal**2 - explained, 0.0)
    return _in_units(process, _standardised_mean(process, covariances)), _of_outputs(process, variance)


def noise_variance(process: GaussianProcess) -> jax.Array:
    """Variance (outputs,) of what is measured about the function."""
    return _of_outputs(process, process.hyperparameters.noise**2)


def _covariances(process: GaussianProcess, one: jax.Array) -> jax.Array:
    """Of the function at an input and at the rows: (groups, n)."""
    at = standardised_inputs(process.scaling, jnp.asarray(one, process.inputs.dtype))
    return jax.vmap(lambda group: covariance_between(process.kernel, group, at, process.inputs))(
        process.hyperparameters
    )


def _standardised_mean(process: GaussianProcess, covariances: jax.Array) -> jax.Array:
    return jnp.einsum("gn,gno->go", covariances, process.weights).reshape(-1)


def _in_units(process: GaussianProcess, standardised: jax.Array) -> jax.Array:
    return process.scaling.output_mean + process.scaling.output_std * standardised


def _of_outputs(process: GaussianProcess, variance: jax.Array) -> jax.Array:
    """Variances (outputs,) in the units of the targets, of standardised ones (groups,)."""
    return process.scaling.output_std**2 * jnp.repeat(variance, process.weights.shape[2])
