"""Evaluate a function of one row for many rows on the CPU, to the same bits whatever rows come with it."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from qjrl.robot.verbs import Robot

BLOCK = 64
"""Rows a compiled call takes; the last call is filled up, so that there is one program for any number of rows."""


def row_by_row(function: Callable[[Robot, jax.Array], Any], robot: Robot, rows: np.ndarray) -> Any:
    """`function(robot, row)` for every row of (n, k), stacked, as numpy arrays.

    `jax.vmap` over all rows would give a row other last bits in another batch: the sizes choose how XLA vectorises.
    On the CPU beside whatever accelerator there is: a row is a chain of tiny operations, each of which would be a kernel
    of its own there, and a data set begins with the same bits on every machine.

    Args:
        function: of the module's level, of one row; returns an array or a tuple of arrays.
    """
    with jax.default_device(_host()):
        blocks = [_block(function, robot, _filled(rows[start : start + BLOCK])) for start in range(0, len(rows), BLOCK)]
    if not blocks:
        empty = jax.eval_shape(functools.partial(function, robot), jax.ShapeDtypeStruct(rows.shape[1:], rows.dtype))
        return jax.tree.map(lambda leaf: np.zeros((0, *leaf.shape), leaf.dtype), empty)
    return jax.tree.map(lambda *parts: np.concatenate([np.asarray(part) for part in parts])[: len(rows)], *blocks)


@functools.partial(jax.jit, static_argnums=0)
def _block(function: Callable[[Robot, jax.Array], Any], robot: Robot, rows: jax.Array) -> Any:
    return jax.lax.map(functools.partial(function, robot), rows)


def _host() -> Any:
    """The CPU as a device; None, the default device, where `JAX_PLATFORMS` leaves it out."""
    try:
        return jax.local_devices(backend="cpu")[0]
    except RuntimeError:
        return None


def _filled(rows: np.ndarray) -> np.ndarray:
    return np.concatenate([rows, np.repeat(rows[-1:], BLOCK - len(rows), axis=0)])
