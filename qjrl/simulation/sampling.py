"""A data set of settled poses: low-discrepancy configurations, their cable lengths, and where the physics rests."""

import os
import shutil
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
from scipy.stats import qmc

from qjrl.artifacts import MANIFEST, ArtifactError, append_shard, read_manifest, remove_unfinished
from qjrl.config import ConfigError, NotIdentity, Range, configuration
from qjrl.keys import key_for
from qjrl.records import check_record
from qjrl.robot import cable_lengths, robot_hash
from qjrl.robot.kinds import kind_of, num_coordinates
from qjrl.robot.verbs import Robot
from qjrl.simulation.row_by_row import row_by_row
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import SettleResult, settle

COPIES_IN_MEMORY = 3
"""Of each row, where a data set is used: the shards, their columns joined, and what a model is fitted on."""


@configuration
class SampleConfig:
    """Group `sample`; all values ours."""

    num_samples: Annotated[int, Range(1, 100_000_000)] = 8192
    """Rows of the data set; powers of two are the most even."""
    shard_size: Annotated[int, Range(1, 1_000_000), NotIdentity()] = 1024
    """Rows settled and written at once: what an interruption can cost."""
    shard: Annotated[int, Range(0, 9999)] | None = None
    """Which of `num_shards` equal parts of the rows this process makes, counted from 0; null = all of them."""
    num_shards: Annotated[int, Range(1, 10_000)] = 4
    """Processes or machines that share the rows, where `shard` says which part is whose."""
    home_share: Annotated[float, Range(0.0, 1.0)] = 0.25
    """Share of the rows whose configurations are all scaled towards home by a common number, uniform in [0, 1].

    Without them hardly a row of eight dimensions lies near home, and there the model is 0.34 mm off, worse than the closed form.
    """

    def __post_init__(self):
        if self.shard is not None and self.shard >= self.num_shards:
            raise ValueError(f"shard: got {self.shard}, allowed: below num_shards = {self.num_shards}")
        if self.shard is not None and self.num_shards > self.num_samples:
            raise ValueError(f"num_shards: got {self.num_shards}, allowed: up to num_samples = {self.num_samples}")


def sample_dataset(
    robot: Robot, simulation: SettleConfig, sample: SampleConfig, seed: int, directory: Path, advance=None
) -> None:
    """Fill `directory` with the rows that `sample` asks for; goes on after what is there.

    Row i is the i-th point of one scrambled Sobol sequence, so an interruption repeats and loses none, and parts made
    elsewhere are those of a single process.

    Raises:
        ConfigError: the rows would not fit on the disk or in memory.
        ArtifactError: the directory holds rows of another robot or made with other settings.
    """
    identity, settings = robot_hash(robot), row_settings(simulation, sample.home_share, seed)
    listed = shards_done(directory, identity)
    if listed and (found := read_manifest(directory).get("settings")) not in (None, settings):
        raise ArtifactError(f"{directory}: holds rows of other settings: {differences(found, settings)}")
    missing = _missing_ranges(sample, listed, directory)
    _check_room(robot, sample, sum(count for _, count in missing), directory)
    remove_unfinished(directory)
    for first_row, count in missing:
        rows = sample_rows(robot, simulation, seed, first_row, count, advance, sample.home_share)
        append_shard(directory, rows, identity, first_row, seed=seed, settings=settings)


def shards_done(directory: Path, identity: str) -> list[dict[str, Any]]:
    """What the manifest of a data set lists already."""
    return read_manifest(directory, identity)["shards"] if (directory / MANIFEST).exists() else []


def check_placed(directory: Path, manifest: dict[str, Any]) -> None:
    """Raises an ArtifactError unless a manifest says which rows each of its files holds, and of which settings."""
    path = directory / MANIFEST
    for entry in manifest["shards"]:
        check_record(path, entry, {"first_row": int}, "a manifest of one part among several")
    check_record(path, manifest, {"settings": dict}, "a manifest of one part among several")


def rows_done(directory: Path, identity: str) -> int:
    """Rows that the manifest of a data set lists already."""
    return sum(shard["rows"] for shard in shards_done(directory, identity))


def num_rows(sample: SampleConfig) -> int:
    """Rows that this process makes."""
    return sum(count for _, count in part_ranges(sample)) if sample.shard is not None else sample.num_samples


def part_ranges(sample: SampleConfig) -> list[tuple[int, int]]:
    """First row and number of rows of each file of one part: every `num_shards`-th of files as equal as can be."""
    assert sample.shard is not None
    files_per_part = -(-sample.num_samples // (sample.num_shards * sample.shard_size))
    files = sample.num_shards * min(files_per_part, sample.num_samples // sample.num_shards)
    starts = [index * sample.num_samples // files for index in range(files + 1)]
    return [(starts[i], starts[i + 1] - starts[i]) for i in range(sample.shard, files, sample.num_shards)]


def row_settings(simulation: SettleConfig, home_share: float, seed: int) -> dict[str, Any]:
    """What the rows depend on besides the robot, by the keys of the configuration."""
    names = ("backend", "timestep", "speed_tolerance", "hold_time", "max_time", "damping_scale")
    settled = {f"simulation.{name}": getattr(simulation, name) for name in names}
    return {"seed": seed, "sample.home_share": home_share} | settled


def differences(found: dict[str, Any], wanted: dict[str, Any]) -> str:
    """``seed is 1 there and 0 here``."""
    keys = [key for key in {**found, **wanted} if found.get(key) != wanted.get(key)]
    return ", ".join(f"{key} is {found.get(key)} there and {wanted.get(key)} here" for key in keys)


def sample_rows(
    robot: Robot, simulation: SettleConfig, seed: int, start: int, count: int, advance=None, home_share: float = 0.0
) -> dict[str, np.ndarray]:
    """Settle rows start .. start + count of the sequence; arrays of the data set's format.

    A simulated robot of statics of its own goes from row to row, the first from home, and its poses are measured with noise.
    """
    lengths = sample_lengths(robot, seed, start, count, home_share)
    if kind_of(robot).rest is None:
        return dataset_rows(robot, lengths, settle(robot, lengths, config=simulation, advance=advance), seed)
    before = sample_lengths(robot, seed, start - 1, 1, home_share) if start else np.zeros((1, robot.num_cables))
    previous = np.concatenate([before, lengths[:-1]])
    result = settle(robot, lengths, config=simulation, advance=advance, previous=previous)
    rows = dataset_rows(robot, lengths, result, seed) | {"previous_cable_lengths": previous}
    return rows | {"pose": _measured(robot, result.pose, seed, start)}


def _measured(robot: Robot, poses: np.ndarray, seed: int, start: int) -> np.ndarray:
    """Poses with the noise of their measurement, which is a row's own."""
    measure = kind_of(robot).measured
    if measure is None:
        return poses
    key, numbers = key_for(seed, "noise of the measured poses"), np.arange(start, start + len(poses))
    noisy = jax.vmap(lambda number, pose: measure(robot, jax.random.fold_in(key, number), pose))
    return np.asarray(jax.jit(noisy)(numbers, poses))


def sample_lengths(robot: Robot, seed: int, start: int, count: int, home_share: float) -> np.ndarray:
    """Commands (count, cables) [m] of rows start .. start + count: configurations even over the limits, a share scaled."""
    numbers = _sobol(num_coordinates(robot) + 1, seed, start, count)
    is_scaled = numbers[:, -1] < home_share
    scale = np.where(is_scaled, numbers[:, -1] / (home_share or 1.0), 1.0)
    return np.asarray(row_by_row(_lengths, robot, np.column_stack([scale, numbers[:, :-1]])), np.float64)


def _lengths(robot: Robot, numbers: jax.Array) -> jax.Array:
    """Cable lengths of one row, from its scale and its configuration's numbers in the unit cube."""
    kind = kind_of(robot)
    home = kind.home(robot)
    return cable_lengths(robot, home + numbers[0] * (kind.from_unit_cube(robot, numbers[1:]) - home))


def dataset_rows(robot: Robot, lengths: np.ndarray, result: SettleResult, seed: int) -> dict[str, np.ndarray]:
    """The columns of a data set from commands (n, cables) [m] and what they settled at."""
    kind = kind_of(robot)
    sensed = {kind.configuration_name: result.configuration} if kind.senses_configuration else {}
    return {
        "cable_lengths": lengths,
        "pose": result.pose,
        **sensed,
        "strand_tension": result.strand_tension,
        "joint_positions": result.joint_positions,
        "equality_error": result.equality_error,
        "speed": result.speed,
        "converged": result.converged,
        "seed": np.full(len(lengths), seed, np.int64),
    }


def _missing_ranges(sample: SampleConfig, listed: list[dict[str, Any]], directory: Path) -> list[tuple[int, int]]:
    """First row and number of rows of each file still to be made."""
    if sample.shard is not None:
        if listed:
            check_placed(directory, read_manifest(directory))
        done = {(shard["first_row"], shard["rows"]) for shard in listed}
        return [file for file in part_ranges(sample) if file not in done]
    starts = range(sum(shard["rows"] for shard in listed), sample.num_samples, sample.shard_size)
    return [(start, min(sample.shard_size, sample.num_samples - start)) for start in starts]


def _sobol(dimensions: int, seed: int, start: int, count: int) -> np.ndarray:
    """Points start .. start + count of the scrambled sequence, (count, dimensions)."""
    sequence = qmc.Sobol(dimensions, rng=seed)
    if start:
        sequence.fast_forward(start)
    return sequence.random(2 ** (count - 1).bit_length())[:count]  # scipy warns of anything but a power of two


def _check_room(robot: Robot, sample: SampleConfig, missing: int, directory: Path) -> None:
    """Refuse what the rows still to come cannot be written to, and what no stage could load."""
    numbers_per_row = robot.num_cables + 9 + num_coordinates(robot) + robot.num_strands + robot.num_positions + 4
    existing = next(path for path in (directory, *directory.absolute().parents) if path.exists())
    on_disk = num_rows(sample) - missing + shutil.disk_usage(existing).free // (8 * numbers_per_row)
    if num_rows(sample) > on_disk:
        _refuse(sample, on_disk * sample.num_samples // num_rows(sample), "fit on the disk")
    in_memory = _memory() // (8 * numbers_per_row * COPIES_IN_MEMORY)
    if sample.num_samples > in_memory:
        _refuse(sample, in_memory, "can be loaded into memory")


def _refuse(sample: SampleConfig, allowed: int, why: str) -> None:
    raise ConfigError(f"sample.num_samples: got {sample.num_samples}, allowed: up to {allowed}, which {why}")


def _memory() -> int:
    """Memory of this machine [bytes]."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
