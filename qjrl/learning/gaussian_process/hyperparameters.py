"""The hyperparameters of a process, and the vector of their logarithms that is optimised."""

from typing import Any

import numpy as np
from flax import struct

from qjrl.learning.gaussian_process.kernels import KERNELS


@struct.dataclass
class Hyperparameters:
    """Of one set of outputs; those of several sets have a leading axis. All of standardised inputs and outputs."""

    length_scales: Any
    """(inputs,)."""
    signal: Any
    """() standard deviation of the function."""
    noise: Any
    """() standard deviation of what is measured about the function."""
    shape: Any
    """() of the rational quadratic kernel; the other kernels have none and leave it at 1."""


def num_logs(kernel: str, num_length_scales: int) -> int:
    """How many numbers the vector of logarithms has."""
    return num_length_scales + 2 + (KERNELS[kernel].shape_slope is not None)


def from_logs(kernel: str, logs: Any, num_inputs: int) -> Hyperparameters:
    """The hyperparameters of logarithms: length scales (one an input, or one of all), signal, noise, the shape if there is one."""
    values = np.exp(logs)
    num_scales = len(values) - num_logs(kernel, 0)
    scales = np.broadcast_to(values[:num_scales], (num_inputs,)).copy()
    rest = values[num_scales:]
    return Hyperparameters(scales, rest[0], rest[1], rest[2] if len(rest) == 3 else np.float64(1.0))
