"""Files of a run: written atomically, read strictly, each directory with its provenance.

Formats: ``.npz`` (named arrays), ``.json``, ``.jsonl`` (one record a line), a dataset directory (shards and
``manifest.json``) and orbax checkpoints (read only here; the policy stage writes them). No pickle.
"""

import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from qjrl import machine, plain_json
from qjrl.records import ArtifactError, Kinds, check_names, check_record, reason_of

DATASET_FORMAT = 1
DONE = "done.json"
PROVENANCE = "provenance.json"
MANIFEST = "manifest.json"


def write_arrays(path: str | Path, arrays: Mapping[str, Any]) -> None:
    """Writes named arrays as an uncompressed ``.npz``: the whole file or none of it."""
    plain = {name: np.asarray(array) for name, array in arrays.items()}
    objects = [name for name, array in plain.items() if array.dtype == object]
    if objects:
        raise ArtifactError(f"{path}: {', '.join(objects)} would need pickle; arrays must hold numbers or texts")
    with _replacing(Path(path)) as file:
        np.savez(file, **plain)  # pyright: ignore[reportArgumentType]


def write_json(path: str | Path, content: Any) -> None:
    """Writes one JSON document, readable by people: the whole file or none of it. NaN and infinity become null."""
    write_bytes(path, (plain_json.dumps(content, indent=2) + "\n").encode())


def write_bytes(path: str | Path, content: bytes) -> None:
    """Writes any other file (a report, a picture): the whole file or none of it."""
    with _replacing(Path(path)) as file:
        file.write(content)


def place_copy(source: str | Path, path: str | Path) -> None:
    """Puts the same file at a second place, without a second copy of its bytes where the file system can do that."""
    temporary = _temporary(Path(path))
    try:
        try:
            os.link(source, temporary)
        except OSError:
            shutil.copyfile(source, temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def remove_unfinished(directory: str | Path) -> None:
    """Deletes what a killed process was writing, where no other process is at work."""
    for path in Path(directory).glob(".*.tmp"):
        path.unlink(missing_ok=True)


def append_json_line(path: str | Path, record: Any) -> None:
    """Appends one record to a ``.jsonl`` file; half a line left by a crash is cut off first. NaN becomes null."""
    line = (plain_json.dumps(record) + "\n").encode()
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    with open(path, "a+b") as file:
        end = file.seek(0, os.SEEK_END)
        file.seek(max(end - 1, 0))
        if file.read(1) not in (b"", b"\n"):
            file.seek(0)
            file.truncate(file.read().rfind(b"\n") + 1)
        file.write(line)
        file.flush()
        os.fsync(file.fileno())


def append_shard(
    directory: str | Path, arrays: Mapping[str, Any], robot_hash: str, first_row: int | None = None, **about: Any
) -> None:
    """Adds rows to a dataset directory: the shard first, then the manifest that makes it count.

    An interruption between the two leaves a shard that the manifest does not list; the next call overwrites it.

    Args:
        arrays: column name -> (rows, ...); the same columns in every shard.
        first_row: number of the first row in the whole data set; default: they follow those that are there.
        about: what else the manifest says (`seed`, `settings`, ...); replaces what it said before.
    """
    directory = Path(directory)
    manifest: dict[str, Any] = {"format": DATASET_FORMAT, "robot_hash": robot_hash, "shards": []}
    if (directory / MANIFEST).exists():
        manifest = read_manifest(directory, robot_hash)
    name = f"shard-{len(manifest['shards']):05d}.npz"
    write_arrays(directory / name, arrays)
    if first_row is None:
        first_row = sum(shard["rows"] for shard in manifest["shards"])
    shard = {"name": name, "first_row": first_row, "rows": len(next(iter(arrays.values())))}
    shard |= {"sha256": hash_of_file(directory / name)}
    write_json(directory / MANIFEST, manifest | about | {"shards": [*manifest["shards"], shard]})


def read_manifest(directory: str | Path, robot_hash: str | None = None) -> dict[str, Any]:
    """The manifest of a dataset directory, checked: format, and the robot when `robot_hash` is given."""
    manifest = read_record(path := Path(directory) / MANIFEST, {"format": int}, "a dataset's manifest")
    if manifest["format"] != DATASET_FORMAT:
        raise ArtifactError(f"{path}: is not a dataset of format {DATASET_FORMAT} (found {manifest['format']})")
    check_record(path, manifest, {"robot_hash": str, "shards": list}, "a dataset's manifest")
    for entry in manifest["shards"]:
        check_record(path, entry, {"name": str, "rows": int, "sha256": str}, "a manifest's shard")
        if entry["name"] != Path(entry["name"]).name:
            raise ArtifactError(f"{path}: lists the shard {entry['name']!r}, expected a file beside it")
    if robot_hash is not None and manifest.get("robot_hash") != robot_hash:
        raise ArtifactError(f"{path}: belongs to another robot ({manifest.get('robot_hash')}, expected {robot_hash})")
    return manifest


def read_record(path: str | Path, kinds: Kinds, what: str) -> dict[str, Any]:
    """The mapping in a JSON file, with the keys that are needed: the one way to read what is then asked by key.

    Args:
        kinds: key -> type of its value; see `check_record`.
        what: what the file is, for the message of the ArtifactError.
    """
    if Path(path).is_dir():
        raise ArtifactError(f"{path}: is a directory, expected {what}")
    return check_record(path, load(path), kinds, what)


def load(path: str | Path, robot_hash: str | None = None) -> Any:
    """Reads any artifact to host memory.

    ``.npz`` -> dict of arrays; ``.json`` -> its content; ``.jsonl`` -> list of records; a dataset directory -> dict
    of concatenated arrays; an orbax checkpoint -> nested dict of arrays; any other directory -> dict from file name
    to loaded content, for the files this function knows.

    Args:
        robot_hash: of a dataset, refuse it if it belongs to another robot.
    Raises:
        ArtifactError: missing, truncated or foreign.
    """
    path = Path(path)
    if path.is_dir():
        return _load_directory(path, robot_hash)
    if (reader := _READERS.get(path.suffix)) is None:
        raise ArtifactError(f"{path}: unknown kind of file, known: {', '.join(_READERS)} and directories of these")
    try:
        return reader(path)
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: does not exist") from error
    except Exception as error:  # damaged bytes make zipfile, NumPy and json raise almost anything
        if isinstance(error, OSError) and not machine.is_of_input(error):
            raise
        raise ArtifactError(f"{path}: is truncated or not a {path.suffix} file ({reason_of(error)})") from error


def load_columns(path: str | Path, names: Collection[str], what: str) -> dict[str, np.ndarray]:
    """The arrays of an ``.npz``, with the `names` that are needed and as many rows of each; raises as `load` does."""
    arrays = load(path)
    check_names(path, arrays, names, what)
    if len({np.shape(arrays[name])[:1] for name in names}) != 1:
        raise ArtifactError(f"{path}: is not {what} (its columns have different numbers of rows); it is damaged")
    return arrays


def load_or_make(path: str | Path, make: Callable[[], Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """The arrays of an ``.npz``, made and written where it does not exist: an interrupted stage goes on behind it."""
    if not Path(path).exists():
        write_arrays(path, make())
    return load(path)


def hash_of(content: Any) -> str:
    """Hexadecimal SHA-256 of the canonical JSON of `content`; key order and tuple or list make no difference."""
    text = json.dumps(plain_json.plain(content), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def hash_of_file(path: str | Path) -> str:
    """Hexadecimal SHA-256 of the bytes of one file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def hash_of_directory(directory: str | Path) -> str:
    """Hash of the names and bytes of all files below a directory, without its provenance and done-marker."""
    root = Path(directory)
    files = sorted(path for path in root.rglob("*") if path.is_file() and path not in (root / DONE, root / PROVENANCE))
    return hash_of([(path.relative_to(root).as_posix(), hash_of_file(path)) for path in files])


def parts_of(directory: str | Path) -> Path:
    """Where processes make the parts of a stage's directory before they are joined, one subdirectory each."""
    return Path(f"{directory}.parts")


def mark_done(directory: str | Path, **about: Any) -> None:
    """Writes the done-marker: from here on the directory is complete."""
    write_json(Path(directory) / DONE, about | {"output_hash": hash_of_directory(directory)})


def done_marker(directory: str | Path) -> dict[str, Any] | None:
    """The content of the done-marker, None where there is none.

    Raises:
        ArtifactError: the marker is damaged.
    """
    path = Path(directory) / DONE
    return read_record(path, {"output_hash": str}, "a done-marker") if path.exists() else None


def _load_directory(directory: Path, robot_hash: str | None) -> Any:
    if (directory / MANIFEST).exists():
        return _load_dataset(directory, robot_hash)
    if (directory / "_METADATA").exists():
        return _load_checkpoint(directory)
    entries = [entry for entry in sorted(directory.iterdir()) if entry.is_dir() or entry.suffix in _READERS]
    return {entry.name: load(entry, robot_hash) for entry in entries if not entry.name.startswith(".")}


def _load_dataset(directory: Path, robot_hash: str | None) -> dict[str, np.ndarray]:
    manifest = read_manifest(directory, robot_hash)
    if not (shards := [_load_shard(directory, shard) for shard in manifest["shards"]]):
        return {}
    if any(shard.keys() != shards[0].keys() for shard in shards):
        raise ArtifactError(f"{directory}: the shards do not have the same columns")
    return {name: np.concatenate([shard[name] for shard in shards]) for name in shards[0]}


def _load_shard(directory: Path, entry: Mapping[str, Any]) -> dict[str, np.ndarray]:
    path = directory / entry["name"]
    arrays = load(path)
    rows = {len(array) for array in arrays.values()}
    if rows != {entry["rows"]}:
        raise ArtifactError(f"{path}: holds {sorted(rows)} rows, its manifest says {entry['rows']}")
    if hash_of_file(path) != entry["sha256"]:
        raise ArtifactError(f"{path}: its content is not what its manifest recorded (sha256 differs)")
    return arrays


def _load_checkpoint(directory: Path) -> Any:
    import jax
    import orbax.checkpoint as ocp
    from etils import epath

    handler, path = ocp.PyTreeCheckpointHandler(), epath.Path(directory.absolute())
    try:
        tree = handler.metadata(path).tree
        to_host = jax.tree.map(lambda _: ocp.RestoreArgs(restore_type=np.ndarray), tree)  # whatever device wrote it
        return handler.restore(path, args=ocp.args.PyTreeRestore(restore_args=to_host))
    except (OSError, ValueError, KeyError) as error:
        raise ArtifactError(f"{directory}: is a damaged checkpoint ({' '.join(str(error).split())})") from error


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    if texts := [name for name, array in arrays.items() if not isinstance(array, np.ndarray)]:
        raise ValueError(f"{', '.join(texts)} is no array")
    return arrays


def _read_json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _read_json_lines(path: Path) -> list[Any]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


_READERS: dict[str, Callable[[Path], Any]] = {".npz": _read_npz, ".json": _read_json, ".jsonl": _read_json_lines}


@contextmanager
def _replacing(path: Path) -> Iterator[BinaryIO]:
    """A temporary file beside `path` that takes its place, on disk for sure, if the block succeeds."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = _temporary(path)
    try:
        with open(temporary, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _temporary(path: Path) -> Path:
    """A name that no other process has, on this machine or another."""
    return path.with_name(f".{path.name}.{secrets.token_hex(8)}.tmp")
