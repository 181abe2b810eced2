"""More rows for a process, its hyperparameters left: the Cholesky factor grows by a block, instead of being made again.

L' = [[L, 0], [B, C]],  B^T = L^-1 K_rows,new,  C C^T = K_new - B B^T
"""

from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from qjrl.learning.gaussian_process.covariance import covariance_between, factor, measured_covariance
from qjrl.learning.gaussian_process.hyperparameters import Hyperparameters
from qjrl.learning.gaussian_process.posterior import GaussianProcess, groups_of, on_host, with_factors
from qjrl.learning.gaussian_process.rows import checked_rows, standardised_inputs, standardised_targets


def add_rows(process: GaussianProcess, inputs: Any, targets: Any) -> GaussianProcess:
    """The process with rows (k, inputs) and (k, outputs) more, scaled as its first ones were.

    Raises:
        ConfigError: as `checked_rows`.
    """
    inputs, targets = checked_rows(inputs, targets, least=1)
    process = on_host(process)
    new = standardised_inputs(process.scaling, inputs)
    factors = [
        _grown(lower, process.kernel, group, process.inputs, new)
        for lower, group in zip(process.cholesky, groups_of(process.hyperparameters), strict=True)
    ]
    targets = np.concatenate([process.targets, standardised_targets(process.scaling, targets)])
    rows = np.concatenate([process.inputs, new]), targets
    return with_factors(process.kernel, process.hyperparameters, process.scaling, rows, np.stack(factors))


def _grown(lower: np.ndarray, kernel: str, group: Hyperparameters, held: np.ndarray, new: np.ndarray) -> np.ndarray:
    below = solve_triangular(lower, covariance_between(kernel, group, held, new), lower=True).T
    corner = factor(measured_covariance(kernel, group, new) - below @ below.T)
    return np.block([[lower, np.zeros((len(held), len(new)))], [below, corner]])
