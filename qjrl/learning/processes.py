"""What the processes of JAX's distributed runtime tell each other; a process alone tells itself.

Rows (copies of an environment) are dealt out in blocks, in the order of the processes. The first process
alone evaluates, reads and writes.
"""

import signal
from typing import Any

import jax
import numpy as np

from qjrl.learning.rendezvous import wait_for_all


def join(coordinator: str, count: int, index: int, patience: float = 60.0) -> None:
    """Makes this process number `index` of `count` that meet at `coordinator` (HOST:PORT), before JAX looks for devices.

    Args:
        patience: longest wait for the others [s].
    Raises:
        MachineError: they have not come by then.

    SIGTERM goes on ending it: JAX catches it for those who save then, and what is at work here loses little anyway.
    """
    wait_for_all(coordinator, count, index, patience)
    jax.distributed.initialize(coordinator, count, index)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def are_several() -> bool:
    """Whether there are others."""
    return jax.process_count() > 1


def is_first() -> bool:
    """Whether this process evaluates, reads and writes."""
    return jax.process_index() == 0


def own(rows: np.ndarray) -> np.ndarray:
    """This process's share of the rows of all."""
    return rows[own_rows(len(rows))]


def own_rows(count: int) -> slice:
    """This process's share of `count` rows, a multiple of the number of processes."""
    share = count // jax.process_count()
    return slice(jax.process_index() * share, (jax.process_index() + 1) * share)


def gathered(rows: Any) -> Any:
    """The rows of all processes, in every process: a pytree of numpy arrays, each with a row for each copy."""
    if not are_several():
        return rows
    from jax.experimental import multihost_utils

    return multihost_utils.process_allgather(rows, tiled=True)


def of_first(values: Any) -> Any:
    """What the first process has, in every process: a pytree of arrays of the same shapes everywhere."""
    if not are_several():
        return values
    from jax.experimental import multihost_utils

    return multihost_utils.broadcast_one_to_all(jax.tree.map(np.asarray, values))


def total(value: float) -> float:
    """The sum over all processes."""
    return float(np.sum(gathered(np.array([value], np.float64))))
