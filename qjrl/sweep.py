"""The record of one run and the table over the runs of a sweep."""

import csv
import io
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from qjrl import artifacts
from qjrl.artifacts import ArtifactError
from qjrl.kept import is_kept

log = logging.getLogger(__name__)

SUMMARY = "summary.json"
_RECORD = {"status": str, "overrides": list, "seconds": int | float | None, "error": str | None}
HEADLINES = (("compare.", ".position_median_mm"), ("forward_model.", ".held_out.median_mm"))
"""First and last part of the metrics worth a column in the terminal: of the latest stage that ran."""


@contextmanager
def recorded(
    run_dir: Path, overrides: list[str], sweep: str | None = None, is_kept: bool = True
) -> Iterator[dict[str, Any]]:
    """Keeps ``summary.json`` of a run: "running" while the block lasts, so that a killed job shows; then its end.

    The block sets `status` (and `error`) in the record it gets; an interruption is recorded here. Nothing is written
    unless `is_kept`.

    Args:
        overrides: of the run, as the user typed them.
        sweep: identity of the sweep that the run belongs to.
    """
    write_json = artifacts.write_json if is_kept else lambda path, content: None
    record: dict[str, Any] = {"status": "running", "overrides": overrides, "sweep": sweep, "started": time.time()}
    record |= {"seconds": None, "error": None}
    start = time.monotonic()
    write_json(run_dir / SUMMARY, record)
    try:
        yield record
    except BaseException:
        record["status"] = "interrupted"
        raise
    finally:
        record["seconds"] = round(time.monotonic() - start, 1)
        try:
            write_json(run_dir / SUMMARY, record)
        except OSError:  # of a run that did not end well something else has been said already
            if record["status"] == "done":
                raise


def gather(sweep_dir: Path, identity: str) -> list[dict[str, Any]]:
    """One row per run of a sweep below `sweep_dir`: its record and its metrics. What cannot be read is said and left out.

    Args:
        identity: what the runs were given as `sweep`.
    """
    rows = []
    for path in sorted(sweep_dir.glob(f"**/{SUMMARY}")):
        record = _unless_damaged(lambda path=path: artifacts.read_record(path, _RECORD, "the record of a run"))
        if record is None or record.get("sweep") != identity:
            continue
        row = {"job": path.parent.relative_to(sweep_dir).as_posix(), **record}
        row["metrics"] = _metrics(path.parent) if record["status"] == "done" else {}
        row["status"] = "did not finish" if record["status"] == "running" else record["status"]
        rows.append(row)
    return rows


def _unless_damaged(read: Callable[[], Any]) -> Any:
    """One file that is damaged must not cost the table over all the others."""
    try:
        return read()
    except ArtifactError as error:
        log.warning("left out of the table: %s", error)
        return None


def write(sweep_dir: Path, rows: list[dict[str, Any]]) -> None:
    """Writes the table as ``sweep.json`` and ``sweep.csv`` (one column per metric)."""
    artifacts.write_json(sweep_dir / "sweep.json", rows)
    flat = [{key: row[key] for key in ("job", "status", "seconds")} | row["metrics"] for row in rows]
    columns = list(dict.fromkeys(key for row in flat for key in row))
    text = io.StringIO()
    table = csv.DictWriter(text, columns)
    table.writeheader()
    table.writerows(flat)
    artifacts.write_bytes(sweep_dir / "sweep.csv", text.getvalue().encode())


def headline(rows: list[dict[str, Any]]) -> list[str]:
    """The metrics to show in a terminal; the files hold all of them."""
    keys = list(dict.fromkeys(key for row in rows for key in row["metrics"]))
    found = ([key for key in keys if key.startswith(first) and key.endswith(last)] for first, last in HEADLINES)
    return next(filter(None, found), [])


def _metrics(run_dir: Path) -> dict[str, float]:
    """All numbers of all stages of a run: ``forward_model.held_out.median_mm``."""
    files = [file for file in sorted(run_dir.glob("*/metrics.json")) if not is_kept(file.parent)]
    return _flat({file.parent.name: _unless_damaged(lambda file=file: artifacts.load(file)) for file in files})


def _flat(metrics: Any, where: str = "") -> dict[str, float]:
    """Nested metrics as dotted names; texts and lists are left out."""
    if isinstance(metrics, Mapping):
        parts = [_flat(value, f"{where}.{key}" if where else str(key)) for key, value in metrics.items()]
        return {key: value for part in parts for key, value in part.items()}
    return {where: metrics} if isinstance(metrics, (int, float)) and not isinstance(metrics, bool) else {}
