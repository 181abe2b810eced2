"""How long a controller waits for one answer of a file."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np


def measure_latency(call: Callable[[Any], Mapping[str, Any]], row: np.ndarray, count: int = 200) -> dict[str, float]:
    """Times of single rows from array to arrays, compiled and warm, on this machine's default device.

    Args:
        call: the function in a file, over a batch.
        row: one input in the file's precision.
    """
    seconds = np.empty(count)
    jax.block_until_ready(call(row[None]))  # compiles
    for number in range(count):
        start = time.perf_counter()
        jax.block_until_ready(call(row[None]))
        seconds[number] = time.perf_counter() - start
    return {
        "calls": count,
        "median_ms": 1e3 * float(np.median(seconds)),
        "p99_ms": 1e3 * float(np.quantile(seconds, 0.99)),
    }
