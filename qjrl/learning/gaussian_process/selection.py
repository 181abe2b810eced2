"""The choice of the next inputs: one after the other the one of greatest predicted variance, given those chosen before."""

from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from qjrl.config import ConfigError
from qjrl.learning.gaussian_process.covariance import covariance_between, diagonal_addition
from qjrl.learning.gaussian_process.hyperparameters import Hyperparameters
from qjrl.learning.gaussian_process.posterior import GaussianProcess, groups_of, on_host
from qjrl.learning.gaussian_process.rows import standardised_inputs


def choose_inputs(process: GaussianProcess, pool: Any, count: int) -> np.ndarray:
    """Row numbers (count,) of a pool of inputs (p, inputs), in the order of their choice.

    The variance is that of standardised outputs, summed over them. It does not depend on what is measured there: each choice adds
    one row to the factor of all groups, as `add_rows` does.

    Raises:
        ConfigError: the pool has fewer rows than are asked for.
    """
    process = on_host(process)
    at = standardised_inputs(process.scaling, np.asarray(pool, np.float64))
    if not 1 <= count <= len(at):
        raise ConfigError(f"count: got {count} of a pool of {len(at)} inputs, allowed: 1 to {len(at)}")
    groups = [
        _Pool(process.kernel, group, lower, process.inputs, at)
        for group, lower in zip(groups_of(process.hyperparameters), process.cholesky, strict=True)
    ]
    chosen: list[int] = []
    for _ in range(count):
        variance = np.sum([group.variance for group in groups], axis=0)
        variance[chosen] = -np.inf
        chosen.append(int(np.argmax(variance)))
        for group in groups:
            group.measure(chosen[-1])
    return np.array(chosen)


class _Pool:
    """What one group of outputs knows of the inputs of a pool; `measure` adds one of them to the rows."""

    def __init__(self, kernel: str, group: Hyperparameters, lower: np.ndarray, held: np.ndarray, at: np.ndarray):
        self._kernel, self._group, self._at = kernel, group, at
        self._solved = solve_triangular(lower, covariance_between(kernel, group, held, at), lower=True)  # (n, p)
        self.variance = group.signal**2 - np.sum(self._solved**2, axis=0)

    def measure(self, index: int) -> None:
        """Add a row to the factor, and what it says of the pool."""
        covariance = covariance_between(self._kernel, self._group, self._at[index], self._at)
        new = covariance - self._solved[:, index] @ self._solved
        new /= np.sqrt(max(self.variance[index], 0.0) + diagonal_addition(self._group))
        self._solved = np.concatenate([self._solved, new[None]])
        self.variance = self.variance - new**2
