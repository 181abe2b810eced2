"""The table of solvers (paper 000, Table 3): its numbers, beside the published ones."""

import csv
from typing import Any

import numpy as np

from qjrl.config import conf_folder
from qjrl.report.tables import Column, Table
from qjrl.solvers import Status
from qjrl.studies.table3.protocol import Measured


def metrics_of(measured: list[Measured], curves: dict[float, np.ndarray]) -> dict[str, Any]:
    """All that is measured, for `metrics.json`: case -> method -> numbers; the curves; what was published."""
    cases: dict[str, dict] = {}
    for one in measured:
        cases.setdefault(one.case, {})[one.method] = numbers_of(one)
    share = {f"{relaxation:g}": curve.tolist() for relaxation, curve in curves.items()}
    return {"cases": cases, "fabrik_success_by_outer_iterations": share, "published": published()}


def numbers_of(one: Measured) -> dict[str, float]:
    """Success, times, iterations and residuals of one solver on one case; units in the names."""
    success = np.array([np.mean(result.converged) for result in one.results])
    joined = {name: np.concatenate([np.asarray(getattr(r, name)) for r in one.results]) for name in _JOINED}
    is_good = joined["converged"]
    positions, orientations = 1e3 * joined["position_error"][is_good], np.degrees(joined["orientation_error"][is_good])
    return {
        "num_targets": len(is_good),
        "success_percent": 100.0 * float(success.mean()),
        "success_percent_lowest_seed": 100.0 * float(success.min()),
        "success_percent_highest_seed": 100.0 * float(success.max()),
        "batch_ms_median": 1e3 * float(np.median(one.batch_seconds)),
        "batch_ms_p99": 1e3 * float(np.quantile(one.batch_seconds, 0.99)),
        "batch_poses_per_second": 1.0 / float(np.median(one.batch_seconds)),
        "single_ms_median": 1e3 * float(np.median(one.single_seconds)),
        "single_ms_p99": 1e3 * float(np.quantile(one.single_seconds, 0.99)),
        "steps_median": float(np.median(joined["steps"])),
        "steps_p99": float(np.quantile(joined["steps"], 0.99)),
        "worst_position_mm": float(positions.max(initial=0.0)),
        "worst_orientation_deg": float(orientations.max(initial=0.0)),
        **{f"{status.name.lower()}_percent": 100.0 * float(np.mean(joined["status"] == status)) for status in Status},
    }


_JOINED = ("converged", "position_error", "orientation_error", "steps", "status")


def published() -> list[dict[str, Any]]:
    """The figures of others, with their source and hardware; none where the package runs without its repository."""
    path = conf_folder().parent / "data" / "table3" / "published.csv"
    if not path.is_file():
        return []
    with open(path, encoding="utf-8", newline="") as file:
        return [
            row | {"success_percent": float(row["success_percent"]), "seconds": float(row["seconds"])}
            for row in csv.DictReader(file)
        ]


def solver_table(metrics: dict[str, Any]) -> Table:
    """One row a case and method; theirs first and marked."""
    theirs = [
        (row["arm"], f"{row['method']} (theirs)", row["success_percent"], None, None, None, 1e3 * row["seconds"])
        + (None,) * 5
        for row in metrics["published"]
    ]
    ours = [
        (
            case,
            method,
            numbers["success_percent"],
            f"{numbers['success_percent_lowest_seed']:.1f}–{numbers['success_percent_highest_seed']:.1f}",
            numbers["batch_ms_median"],
            numbers["batch_ms_p99"],
            numbers["single_ms_median"],
            numbers["single_ms_p99"],
            numbers["steps_median"],
            numbers["steps_p99"],
            numbers["worst_position_mm"],
            numbers["worst_orientation_deg"],
        )
        for case, methods in metrics["cases"].items()
        for method, numbers in methods.items()
    ]
    return Table(_COLUMNS, (*theirs, *ours), marked=frozenset(range(len(theirs))), note=_NOTE)


_COLUMNS = (
    Column("arm and targets"),
    Column("method"),
    Column("success", 2, "%"),
    Column("seeds", None, "%"),
    Column("batch", 4, "ms/pose"),
    Column("p99", 4, "ms/pose"),
    Column("single", 2, "ms"),
    Column("p99", 2, "ms"),
    Column("steps", 0),
    Column("p99", 0),
    Column("worst converged", 5, "mm"),
    Column("worst converged", 5, "°"),
)
_NOTE = "* published; mean time, MATLAB on an AMD Ryzen 7 5800H. Compilation is in no time."
