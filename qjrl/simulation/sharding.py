"""Join the parts of a data set that many processes made: every row once, all of one arm and one configuration."""

import dataclasses
import itertools
import shutil
from pathlib import Path
from typing import Any

from qjrl.artifacts import MANIFEST, ArtifactError, hash_of_file, place_copy, read_manifest, write_json
from qjrl.kept import is_kept
from qjrl.simulation.sampling import check_placed, differences


@dataclasses.dataclass(frozen=True)
class _Shard:
    """A file of rows as the manifest of its part lists it."""

    part: Path
    entry: dict[str, Any]

    @property
    def file(self) -> Path:
        return self.part / self.entry["name"]

    @property
    def first(self) -> int:
        return self.entry["first_row"]

    @property
    def end(self) -> int:
        return self.first + self.entry["rows"]


def join_parts(parts: Path, directory: Path, robot_hash: str, settings: dict[str, Any], num_samples: int) -> None:
    """Make one data set in `directory` of the parts below `parts`, without settling anything; the parts stay.

    Args:
        parts: holds one data set directory per part, see `qjrl.simulation.sampling.sample_dataset`.
        directory: what a data set there listed before is replaced.
        settings: of `row_settings`; those of every part must equal it.
        num_samples: rows that the parts must hold together.
    Raises:
        ArtifactError: a part is of another robot or other settings, damaged, or rows are missing or there twice.
    """
    manifests = {part: read_manifest(part, robot_hash) for part in part_directories(parts)}
    for part, manifest in manifests.items():
        check_placed(part, manifest)
        if unlike := differences(manifest["settings"], settings):
            raise ArtifactError(f"{part}: was made with another configuration: {unlike}; {_way_out(parts)}")
    shards = [_Shard(part, entry) for part, manifest in manifests.items() for entry in manifest["shards"]]
    shards.sort(key=lambda shard: shard.first)
    _check_each_row_once(parts, shards, num_samples)
    _place(directory, shards, next(iter(manifests.values())))


def part_directories(parts: Path) -> list[Path]:
    """The parts that hold rows; what made room for a part is none."""
    return [path.parent for path in sorted(parts.glob(f"*/{MANIFEST}")) if not is_kept(path.parent)]


def remove_parts(parts: Path) -> None:
    """Removes the parts, once the data set that was made of them stands; what made room for one of them stays."""
    for part in part_directories(parts):
        shutil.rmtree(part, ignore_errors=True)
    if not any(path.is_dir() for path in parts.iterdir()):
        shutil.rmtree(parts, ignore_errors=True)


def _check_each_row_once(parts: Path, shards: list[_Shard], num_samples: int) -> None:
    for one, other in itertools.pairwise(shards):
        if other.first < one.end:
            names = f"{one.part.name}/{one.entry['name']} and {other.part.name}/{other.entry['name']}"
            rows = _rows(other.first, min(one.end, other.end))
            raise ArtifactError(f"{parts}: {rows} are there twice, in {names}; delete one of these parts")
    if shards and shards[-1].end > num_samples:
        last = f"{shards[-1].part.name} has {_rows(shards[-1].first, shards[-1].end)}"
        raise ArtifactError(f"{parts}: {last}, but sample.num_samples is {num_samples} here; {_way_out(parts)}")
    ends, starts = [0, *(shard.end for shard in shards)], [*(shard.first for shard in shards), num_samples]
    gaps = [_rows(end, start) for end, start in zip(ends, starts, strict=True) if end < start]
    if gaps:
        named = ", ".join(gaps[:3]) + (f" and {len(gaps) - 3} more gaps" if len(gaps) > 3 else "")
        raise ArtifactError(
            f"{parts}: {named} of {num_samples} are missing; the same sample.shard=... again makes what is not there, "
            f"or delete the directory to settle all rows in one run"
        )


def _place(directory: Path, shards: list[_Shard], manifest: dict[str, Any]) -> None:
    """The files under the names of one data set, checked, then the manifest, then nothing else."""
    for shard in shards:
        if not shard.file.exists() or hash_of_file(shard.file) != shard.entry["sha256"]:
            raise ArtifactError(f"{shard.file}: is missing or damaged; delete {shard.part} and make that part again")
    directory.mkdir(parents=True, exist_ok=True)
    (directory / MANIFEST).unlink(missing_ok=True)  # what it lists is about to be replaced
    entries = [shard.entry | {"name": f"shard-{index:05d}.npz"} for index, shard in enumerate(shards)]
    for shard, entry in zip(shards, entries, strict=True):
        place_copy(shard.file, directory / entry["name"])
    for path in directory.glob("shard-*.npz"):
        if path.name not in {entry["name"] for entry in entries}:
            path.unlink()
    write_json(directory / MANIFEST, manifest | {"shards": entries})


def _rows(first: int, end: int) -> str:
    return f"rows {first} to {end - 1}" if end - first > 1 else f"row {first}"


def _way_out(parts: Path) -> str:
    return f"give the same values, or delete {parts}"
