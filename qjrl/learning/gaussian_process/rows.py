"""The rows that a process is given: what is refused, and how they are standardised."""

from typing import Any

import numpy as np
from flax import struct

from qjrl.config import ConfigError

LEAST_ROWS = 10


@struct.dataclass
class Scaling:
    """Means and standard deviations that standardise inputs and outputs; 1 where a column does not change."""

    input_mean: Any
    """(inputs,)."""
    input_std: Any
    output_mean: Any
    """(outputs,)."""
    output_std: Any


def checked_rows(inputs: Any, targets: Any, least: int = LEAST_ROWS) -> tuple[np.ndarray, np.ndarray]:
    """The rows (n, inputs) and (n, outputs) in float64.

    Raises:
        ConfigError: one line; other shapes, fewer than `least` rows, or values that are not finite.
    """
    inputs, targets = np.asarray(inputs, np.float64), np.asarray(targets, np.float64)
    if inputs.ndim != 2 or targets.ndim != 2 or len(inputs) != len(targets):
        raise ConfigError(
            f"Gaussian process: got inputs {inputs.shape} and targets {targets.shape}, allowed: as many rows of both"
        )
    if len(inputs) < least:
        raise ConfigError(f"Gaussian process: got {len(inputs)} rows, allowed: at least {least}")
    for name, rows in (("inputs", inputs), ("targets", targets)):
        wrong = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        if len(wrong):
            raise ConfigError(
                f"Gaussian process: got a value that is not finite in {name} row {wrong[0]} (the first is 0), as in "
                f"{len(wrong)} rows in all, allowed: finite numbers"
            )
    return inputs, targets


def scaling_of(inputs: np.ndarray, targets: np.ndarray) -> Scaling:
    """What standardises the rows."""
    return Scaling(inputs.mean(axis=0), _deviation(inputs), targets.mean(axis=0), _deviation(targets))


def no_scaling(num_inputs: int, num_outputs: int) -> Scaling:
    """What leaves rows as they are."""
    return Scaling(np.zeros(num_inputs), np.ones(num_inputs), np.zeros(num_outputs), np.ones(num_outputs))


def standardised_inputs(scaling: Scaling, inputs: Any) -> Any:
    """Inputs (..., inputs) in the units of the process."""
    return (inputs - scaling.input_mean) / scaling.input_std


def standardised_targets(scaling: Scaling, targets: Any) -> Any:
    """Targets (..., outputs) in the units of the process."""
    return (targets - scaling.output_mean) / scaling.output_std


def _deviation(rows: np.ndarray) -> np.ndarray:
    deviation = rows.std(axis=0)
    return np.where(deviation > 1e-12 * np.abs(rows).max(axis=0), deviation, 1.0)
