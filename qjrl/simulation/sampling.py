"""A data set of settled poses: low-discrepancy bends, their cable lengths, and where the physics rests."""

import dataclasses
import shutil
from pathlib import Path
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from qjrl.artifacts import append_shard, read_manifest
from qjrl.config import ConfigError, Range
from qjrl.robot import cable_lengths, robot_hash
from qjrl.robot.quaternion_arm.sampling import bends_from_unit_cube
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import SettleResult, settle


@dataclasses.dataclass(frozen=True)
class SampleConfig:
    """Group `sample`."""

    num_samples: Annotated[int, Range(1, 100_000_000)] = 8192
    """Rows of the data set; powers of two are the most even."""
    shard_size: Annotated[int, Range(1, 1_000_000)] = 1024
    """Rows settled and written at once: what an interruption can cost."""


def sample_dataset(
    robot: Robot, simulation: SettleConfig, sample: SampleConfig, seed: int, directory: Path, advance=None
) -> None:
    """Fill `directory` up to `num_samples` rows; goes on after the last shard that is there.

    Row i is the i-th point of one scrambled Sobol sequence, so an interruption repeats and loses none.

    Raises:
        ConfigError: the rows would not fit on the disk.
        ArtifactError: the directory holds rows of another robot.
    """
    identity = robot_hash(robot)
    done = rows_done(directory, identity)
    _check_disk(robot, sample, done, directory)
    while done < sample.num_samples:
        count = min(sample.shard_size, sample.num_samples - done)
        rows = sample_rows(robot, simulation, seed, done, count, advance)
        append_shard(directory, rows, identity, seed=seed)
        done += count


def rows_done(directory: Path, identity: str) -> int:
    """Rows that the manifest of a data set lists already."""
    if not (directory / "manifest.json").exists():
        return 0
    return sum(shard["rows"] for shard in read_manifest(directory, identity)["shards"])


def sample_rows(
    robot: Robot, simulation: SettleConfig, seed: int, start: int, count: int, advance=None
) -> dict[str, np.ndarray]:
    """Settle rows start .. start + count of the sequence; arrays of the data set's format."""
    numbers = _sobol(2 * robot.num_segments, seed, start, count)
    to_lengths = jax.jit(jax.vmap(lambda row: cable_lengths(robot, bends_from_unit_cube(robot, row))))
    lengths = np.asarray(to_lengths(jnp.asarray(numbers)), np.float64)
    return dataset_rows(lengths, settle(robot, lengths, config=simulation, advance=advance), seed)


def dataset_rows(lengths: np.ndarray, result: SettleResult, seed: int) -> dict[str, np.ndarray]:
    """The columns of a data set from commands (n, cables) [m] and what they settled at."""
    return {
        "cable_lengths": lengths,
        "pose": result.pose,
        "bends": result.bends,
        "strand_tension": result.strand_tension,
        "joint_positions": result.joint_positions,
        "equality_error": result.equality_error,
        "speed": result.speed,
        "converged": result.converged,
        "seed": np.full(len(lengths), seed, np.int64),
    }


def _sobol(dimensions: int, seed: int, start: int, count: int) -> np.ndarray:
    """Points start .. start + count of the scrambled sequence, (count, dimensions)."""
    sequence = qmc.Sobol(dimensions, rng=seed)
    if start:
        sequence.fast_forward(start)
    return sequence.random(2 ** (count - 1).bit_length())[:count]  # scipy warns of anything but a power of two


def _check_disk(robot: Robot, sample: SampleConfig, done: int, directory: Path) -> None:
    """Refuse what the rows still to come cannot be written to."""
    numbers_per_row = robot.num_cables + 9 + 2 * robot.num_segments + robot.num_strands + 5 * robot.num_joints + 4
    existing = next(path for path in (directory, *directory.absolute().parents) if path.exists())
    free = shutil.disk_usage(existing).free
    fitting = done + free // (8 * numbers_per_row)
    if sample.num_samples > fitting:
        raise ConfigError(
            f"sample.num_samples: got {sample.num_samples}, allowed: up to {fitting}, which fit on the disk"
        )
