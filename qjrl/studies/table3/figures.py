"""Pictures of solvers: success against outer iterations, what is left where FABRIK fails, and how the solvers compare."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from qjrl.report.canvas import logarithmic, new_plot, style
from qjrl.report.palette import LIGHT, series_colour
from qjrl.solvers import Status
from qjrl.studies.table3.protocol import Measured

_STATUS_LOOK = {
    Status.STALLED: ("turn and reach cancel", "orange"),
    Status.ITERATION_LIMIT: ("still moving at the last iteration", "blue"),
    Status.OUTSIDE_LIMITS: ("beyond a joint limit", "violet"),
}


@style()
def success_figure(curves: dict[float, np.ndarray], paper_percent: float | None) -> Figure:
    """Share of targets reached against outer iterations, one line a relaxation."""
    figure, axes = new_plot("outer iterations", "targets FABRIK has reached [%]")
    for index, (relaxation, curve) in enumerate(curves.items()):
        iterations = np.arange(1, len(curve) + 1)
        axes.plot(iterations, 100.0 * curve, color=series_colour(index), label=f"λ = {relaxation:g}")
    if paper_percent is not None:
        axes.axhline(paper_percent, color=LIGHT["muted"], linewidth=1.0, linestyle=(0, (4, 3)), label="paper's figure")
    axes.set_ylim(0.0, 100.0)
    logarithmic(axes, "x")
    axes.legend(loc="upper left")
    return figure


@style()
def failures_figure(fabrik: Measured) -> Figure:
    """Every target that FABRIK misses: the errors left, coloured by how the solve ended."""
    figure, axes = new_plot("position error left [mm]", "orientation error left [°]")
    position, orientation, status = (
        np.concatenate([np.asarray(getattr(result, name)) for result in fabrik.results])
        for name in ("position_error", "orientation_error", "status")
    )
    for ended, (label, colour) in _STATUS_LOOK.items():
        rows = status == ended
        axes.plot(
            1e3 * np.maximum(position[rows], 1e-8),
            np.degrees(np.maximum(orientation[rows], 1e-7)),
            "o", markersize=3.0, alpha=0.5, markeredgewidth=0.0, color=LIGHT[colour],
            label=f"{label}: {100.0 * np.mean(rows):.1f} % of targets",
        )  # fmt: skip
    logarithmic(axes, "x")
    logarithmic(axes, "y")
    axes.legend(loc="lower right")
    return figure


@style()
def success_by_bend_figure(fabrik: Measured, angles: np.ndarray, num_bins: int = 10) -> Figure:
    """How the solves of the first seed ended against the largest bend angle of the target's own configuration.

    Args:
        angles: (n, segments) [rad], of the first seed's targets.
    """
    figure, axes = new_plot("largest bend angle of the target's configuration [°]", "targets [%]")
    largest, status = np.degrees(angles.max(axis=1)), np.asarray(fabrik.results[0].status)
    groups = np.array_split(np.argsort(largest), num_bins)
    edges = np.array([largest[group[0]] for group in groups] + [largest.max()])
    bottom = np.zeros(len(groups))
    for ended, (label, colour) in ((Status.CONVERGED, ("reached", "teal")), *_STATUS_LOOK.items()):
        share = np.array([100.0 * np.mean(status[group] == ended) for group in groups])
        axes.bar(
            edges[:-1], share, np.diff(edges), bottom, align="edge", color=LIGHT[colour],
            edgecolor=LIGHT["paper"], linewidth=0.5, label=label,
        )  # fmt: skip
        bottom += share
    axes.set_ylim(0.0, 100.0)
    axes.legend(loc="lower left", frameon=True)
    return figure


@style()
def trade_figure(metrics: dict[str, Any]) -> Figure:
    """Success against time per pose in a batch, of every method and case; what was published beside them."""
    figure, axes = new_plot("time per pose [ms]: batch on all cores; theirs one at a time", "targets reached [%]")
    markers = "os^Dv"
    for column, (case, methods) in enumerate(metrics["cases"].items()):
        for row, (method, numbers) in enumerate(methods.items()):
            axes.plot(
                numbers["batch_ms_median"], numbers["success_percent"], markers[column % len(markers)],
                color=series_colour(row), label=method if column == 0 else None,
            )  # fmt: skip
        axes.plot([], [], markers[column % len(markers)], color=LIGHT["muted"], label=case)
    for index, row in enumerate(metrics["published"]):
        axes.plot(
            1e3 * row["seconds"],
            row["success_percent"],
            "x+"[index % 2],
            color=LIGHT["ink"],
            label=f"{row['method']} (theirs)",
        )
    axes.set_ylim(0.0, 102.0)
    logarithmic(axes, "x")
    axes.legend(loc="lower left", fontsize=7.5)
    return figure
