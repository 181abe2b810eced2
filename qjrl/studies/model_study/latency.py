"""How long a forward model takes on this machine: one row at a time, and in a batch. Compilation is in no time."""

import time
from collections.abc import Callable
from typing import Annotated, Any

import jax
import jax.numpy as jnp

from qjrl.config import Range, configuration
from qjrl.robot.forward_model import pose_function
from qjrl.robot.model_kind import FittedModel
from qjrl.robot.verbs import Robot, cable_strokes


@configuration
class LatencyConfig:
    """How often is measured; the medians count."""

    single_calls: Annotated[int, Range(1)] = 500
    """Calls with one row."""
    batch_size: Annotated[int, Range(1)] = 8192
    """Rows of the batch."""
    batch_calls: Annotated[int, Range(1)] = 9
    """Calls with the batch."""


def measure_latency(robot: Robot, model: FittedModel | None, config: LatencyConfig) -> dict[str, float]:
    """Microseconds of a call with one row, its input on the host as a controller has it, and rows a second in a batch."""
    pose = pose_function(robot, model)
    lengths = cable_strokes(robot) * jax.random.uniform(
        jax.random.key(0), (config.batch_size, robot.num_cables), minval=-0.5, maxval=0.5
    )
    single, batch = jax.jit(lambda model, row: model(row)), jax.jit(lambda model, rows: jax.vmap(model)(rows))
    row = jax.device_get(lengths[0])
    return {
        "single_us": 1e6 * _median_seconds(lambda: single(pose, row), config.single_calls),
        "batch_rows_per_s": config.batch_size / _median_seconds(lambda: batch(pose, lengths), config.batch_calls),
    }


def _median_seconds(function: Callable[[], Any], calls: int) -> float:
    jax.block_until_ready(function())
    times = []
    for _ in range(calls):
        start = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - start)
    return float(jnp.median(jnp.asarray(times)))
