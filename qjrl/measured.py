"""Measured numbers that one stage reads of another: `metrics.json`, and `progress.jsonl` with one record a line."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from qjrl import artifacts
from qjrl.artifacts import ArtifactError
from qjrl.plain_json import numbers_again
from qjrl.records import NUMBER, Kinds, check_record


def read_metrics(path: str | Path, kinds: Kinds) -> dict[str, Any]:
    """The numbers in a JSON file, NaN where it has null.

    Args:
        kinds: of what is asked by key; see `check_record`.
    Raises:
        ArtifactError: the file is missing or damaged, or lacks one of them.
    """
    return numbers_again(artifacts.read_record(path, kinds, "a file of measured numbers"))


def read_progress(path: str | Path, *needed: str) -> list[dict[str, float]]:
    """The records of a training, one a line, at least one: names -> numbers, NaN where the file has null.

    Args:
        needed: names that every record has.
    Raises:
        ArtifactError: the file is missing or damaged, or a record lacks a name or holds something else than numbers.
    """
    records = artifacts.load(path)
    if not records:
        raise ArtifactError(f"{path}: holds no record")
    for number, record in enumerate(records, start=1):
        found = record if isinstance(record, Mapping) else ()
        check_record(f"{path}, line {number}", record, dict.fromkeys([*needed, *found], NUMBER), "measured numbers")
    return numbers_again(records)
