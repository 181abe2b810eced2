"""Any number of rows through a function compiled for few: padded batches, one host thread a core."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from qjrl.cores import usable_cores

SMALL_BATCH = 16
"""Rows of the batch that few rows are padded to, so that a single target need not wait for a full one."""


def in_batches(function: Callable[..., Any], batch_size: int, *rows: Any) -> Any:
    """`function(*rows)` in batches: two compilations whatever the number of rows, and all cores at work.

    Args:
        function: arrays with equally many rows -> a pytree of arrays with as many rows; compiled, thread-safe.
        batch_size: rows of a batch; the last one is padded with its own rows.
        rows: arrays, or pytrees of them, whose first axis are the same rows, at least one.
    """
    count = len(jax.tree.leaves(rows)[0])
    size = min(batch_size, SMALL_BATCH) if count <= SMALL_BATCH else batch_size
    chunks = [np.resize(np.arange(start, min(start + size, count)), size) for start in range(0, count, size)]

    def run(chunk: np.ndarray) -> Any:
        return jax.tree.map(np.asarray, function(*jax.tree.map(lambda values: values[chunk], rows)))

    first = run(chunks[0])  # alone: what must be compiled is compiled once
    if len(chunks) == 1:
        return jax.tree.map(lambda value: value[:count], first)
    with ThreadPoolExecutor(usable_cores()) as pool:
        parts = [first, *pool.map(run, chunks[1:])]
    return jax.tree.map(lambda *values: np.concatenate(values)[:count], *parts)
