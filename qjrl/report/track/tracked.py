"""How well a tip followed its path: arrays over the time of the plan, and the numbers of a report."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from qjrl.report.tables import Column, Table


@dataclasses.dataclass(frozen=True)
class Tracked:
    """One performance while its plan moves; all arrays over the same times."""

    share: float
    """Of the feasible speed."""
    lead: float
    """Of the commands before the plan [s]."""
    time: np.ndarray
    """(n,) [s]."""
    position: np.ndarray
    """(n,) distance from where the tip should be now [m]."""
    across: np.ndarray
    """(n,) distance from the path [m]."""
    along: np.ndarray
    """(n,) ahead (+) or behind (-) along the path [m]."""
    orientation: np.ndarray
    """(n,) [rad]."""
    speed: np.ndarray
    """(n,) planned, of the tip [m/s]."""
    strand_tension: np.ndarray
    """(n, strands) [N]."""
    motor_force: np.ndarray
    """(n, cables) [N]."""
    is_finite: bool = True
    """Whether the simulation stayed finite."""

    @property
    def lag(self) -> float:
        """Time by which the tip is behind, from a fit of its distance behind to its speed [s]."""
        return float(-(self.along @ self.speed) / max(float(self.speed @ self.speed), 1e-300))


def tracked_metrics(one: Tracked) -> dict[str, float | bool]:
    """Numbers of one performance, in mm, degrees, ms, N."""
    quantiles = {}
    for name, values in {
        "position": 1e3 * one.position,
        "across": 1e3 * one.across,
        "along": 1e3 * np.abs(one.along),
    }.items():
        quantiles |= _quantiles(name, "mm", values)
    return {
        "share_of_feasible_speed": one.share,
        "lead_ms": 1e3 * one.lead,
        "duration_s": float(one.time[-1]),
        "tip_speed_max_mm_s": 1e3 * float(one.speed.max()),
        **quantiles,
        **_quantiles("orientation", "deg", np.degrees(one.orientation)),
        "lag_ms": 1e3 * one.lag,
        "tension_min_N": float(one.strand_tension.min()),
        "tension_max_N": float(one.strand_tension.max()),
        "motor_force_max_N": float(np.abs(one.motor_force).max()),
        "is_finite": one.is_finite,
    }


def position_metrics(position: np.ndarray, orientation: np.ndarray) -> dict[str, float]:
    """Quantiles of position [m] and orientation [rad] errors (n,), in mm and degrees."""
    return _quantiles("position", "mm", 1e3 * position) | _quantiles("orientation", "deg", np.degrees(orientation))


def _quantiles(name: str, unit: str, values: np.ndarray) -> dict[str, float]:
    return {
        f"{name}_median_{unit}": float(np.median(values)),
        f"{name}_p99_{unit}": float(np.percentile(values, 99)),
        f"{name}_max_{unit}": float(values.max()),
    }


def command_metrics(commands: np.ndarray, period: float, bounds: tuple[float, float, float]) -> dict[str, float]:
    """Largest divided differences of commands (n, cables) [m], each also as the share of its bound that it uses.

    Args:
        bounds: speed [m/s], acceleration [m/s^2], jerk [m/s^3].
    """
    found = {}
    for order, (name, bound) in enumerate(zip(("speed", "acceleration", "jerk"), bounds, strict=True), 1):
        largest = float(np.abs(np.diff(commands, order, axis=0)).max(initial=0.0)) / period**order
        found |= {f"cable_{name}_max": largest, f"cable_{name}_share": largest / bound}
    return found


def tracking_table(metrics: Mapping[str, Mapping[str, Any]]) -> Table:
    """One row a performance; name -> `tracked_metrics`."""
    columns = (
        Column("played"), Column("duration", 2, "s"), Column("tip speed", 0, "mm/s"),
        Column("median", 3, "mm", "position"), Column("p99", 3, "mm", "position"), Column("max", 3, "mm", "position"),
        Column("across p99", 3, "mm", "position"), Column("lag", 2, "ms"), Column("median", 3, "°", "orientation"),
        Column("p99", 3, "°", "orientation"), Column("least", 1, "N", "tension"), Column("most", 1, "N", "tension"),
        Column("motor", 1, "N"),
    )  # fmt: skip
    keys = (
        "duration_s", "tip_speed_max_mm_s", "position_median_mm", "position_p99_mm", "position_max_mm", "across_p99_mm",
        "lag_ms", "orientation_median_deg", "orientation_p99_deg", "tension_min_N", "tension_max_N", "motor_force_max_N",
    )  # fmt: skip
    rows = tuple((name, *(one[key] for key in keys)) for name, one in metrics.items())
    return Table(columns, rows, frozenset({0}), "* the plan; the others are for comparison")
