"""The table of a model study: one row a fit."""

from typing import Any

from qjrl.report.tables import Column, Table

_COLUMNS = (
    Column("study"), Column("choice"), Column("rows", 0), Column("epochs", 0),
    Column("median", 4, "mm"), Column("p90", 3, "mm"), Column("p99", 3, "mm"),
    Column("median", 4, "°"), Column("p90", 3, "°"), Column("p99", 3, "°"),
    Column("fitted rows", 4, "mm"), Column("CPU", 0, "s"), Column("single", 0, "µs"), Column("batch", 0, "rows/s"),
)  # fmt: skip
_ERRORS = ("median_mm", "p90_mm", "p99_mm", "median_deg", "p90_deg", "p99_deg")
PARTS = ("paper", "corrected", "coordinates", "frequencies", "blocks", "width", "latency", "ensemble")
"""Parts of the study, in the order of the table."""


def study_table(metrics: dict[str, Any]) -> Table:
    """Held-out errors of every fit; "fitted rows" is the median on rows of the fit itself."""
    rows = tuple(_row(part, label, result) for part in PARTS for label, result in metrics[part].items())
    return Table(_COLUMNS, rows, note="one seed; a fit that several parts share was made once")


def _row(part: str, label: str, result: dict[str, Any]) -> tuple:
    errors = [result["held_out"][name] for name in _ERRORS]
    rate = (result.get("single_us"), result.get("batch_rows_per_s"))
    about = (part, label, result["rows"], result["epochs"])
    return (*about, *errors, result["fitted"]["median_mm"], result["cpu_seconds"], *rate)
