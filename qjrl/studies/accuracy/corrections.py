"""Controllers that measure and correct: their errors by the number of measurements, as numbers, ratios and a table."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from scipy import stats

from qjrl.report.metrics import quantiles
from qjrl.report.outcomes import controller_label
from qjrl.report.tables import Column, Table

# Median length of a vector whose three components are normal with standard deviation 1.
MEDIAN_OF_THREE_NORMALS = float(np.sqrt(stats.chi2.median(3)))


class Errors(Protocol):
    """Errors of one controller on the same n targets after 0, 1, 2, ... measurements."""

    @property
    def position_error(self) -> np.ndarray:
        """(measurements + 1, n) [m]; NaN where the arm did not settle."""
        ...

    @property
    def orientation_error(self) -> np.ndarray:
        """(measurements + 1, n) [rad]."""
        ...


Runs = Mapping[str, Errors]
"""Controller -> its errors."""


def corrections_metrics(runs: Runs) -> dict[str, dict[str, dict[str, float]]]:
    """ "after_0" (open loop), "after_1" ... -> controller -> quantiles; what did not settle is counted and left out."""
    return {f"after_{number}": {name: _numbers(one, number) for name, one in runs.items()} for number in _counts(runs)}


def ratios(runs: Runs, solved: Mapping[str, np.ndarray], reference: str = "learned_ik") -> dict[str, Any]:
    """How many times smaller the reference's median position error is than each other's, at equally many measurements.

    Args:
        solved: controller -> (n,) whether it solved the target in the model that it inverts: the ratio is given on those
            targets alone too.
    """
    best = runs[reference].position_error
    return {
        f"after_{number}": {
            name: _ratio(one.position_error[number], best[number], np.ones_like(solved[name]), "")
            | _ratio(one.position_error[number], best[number], solved[name], "_where_it_solves")
            for name, one in runs.items()
            if name != reference
        }
        for number in _counts(runs)
    }


def noise_floor(position: float, orientation: float) -> dict[str, float]:
    """What noise of one measurement leaves of a perfect correction: the median length of its own error.

    Args:
        position: standard deviation in every axis [m]; orientation: [rad].
    """
    scale = MEDIAN_OF_THREE_NORMALS
    return {
        "position_deviation_mm": 1e3 * position,
        "orientation_deviation_deg": float(np.degrees(orientation)),
        "position_median_mm": 1e3 * scale * position,
        "orientation_median_deg": float(np.degrees(scale * orientation)),
    }


def corrections_table(metrics: Mapping[str, Mapping[str, Any]], note: str = "") -> Table:
    """One row a kind of measurement, controller and number of measurements.

    Args:
        metrics: what the measurements are like -> `corrections_metrics`.
    """
    columns = (
        Column("measurements"), Column("controller"), Column("number", 0), Column("median", 4, "mm"), Column("p90", 4, "mm"),
        Column("p99", 4, "mm"), Column("median", 4, "°"), Column("p99", 4, "°"), Column("unsettled", 0),
    )  # fmt: skip
    keys = ("position_median_mm", "position_p90_mm", "position_p99_mm", "orientation_median_deg", "orientation_p99_deg")
    rows = [
        (kind, controller_label(name), number, *(found[key] for key in keys), found["num_unsettled"])
        for kind, counts in metrics.items()
        for name in counts["after_0"]
        for number, found in enumerate(after[name] for after in counts.values())
    ]
    return Table(columns, tuple(rows), note=note)


def _counts(runs: Runs) -> range:
    return range(len(next(iter(runs.values())).position_error))


def _numbers(one: Errors, number: int) -> dict[str, float]:
    has_settled = ~np.isnan(one.position_error[number])
    position = 1e3 * one.position_error[number][has_settled]
    orientation = np.degrees(one.orientation_error[number][has_settled])
    return {
        "num_unsettled": int((~has_settled).sum()),
        **quantiles(position, "position", "mm"),
        **quantiles(orientation, "orientation", "deg"),
    }


def _ratio(values: np.ndarray, best: np.ndarray, rows: np.ndarray, name: str) -> dict[str, float]:
    """On the rows that settled for both."""
    rows = rows & ~np.isnan(values) & ~np.isnan(best)
    if not rows.any():
        return {}
    ratio = float(np.median(values[rows]) / np.median(best[rows]))
    return {f"ratio{name}": ratio, f"orders_of_magnitude{name}": float(np.log10(ratio))}
