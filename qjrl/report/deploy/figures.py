"""Pictures of a deployment: how quick the controller answered, and how near the tip came."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from qjrl.report.canvas import new_plot, style
from qjrl.report.palette import LIGHT, series_colour


@style()
def latency_histogram(latency_s: np.ndarray, accepted: float) -> Figure:
    """Latency (n,) of the controller, with its 99th percentile and the accepted one [s]."""
    latency = 1e3 * latency_s
    figure, axes = new_plot("latency of the controller [ms]", "control periods", 7.2, 3.5)
    axes.hist(latency, np.geomspace(0.9 * latency.min(), 1.1 * latency.max(), 60).tolist(), color=LIGHT["blue"])
    axes.set_xscale("log")
    axes.set_yscale("symlog", linthresh=10.0)
    quantile = float(np.quantile(latency, 0.99))
    axes.axvline(quantile, color=LIGHT["orange"], label=f"99 %: {quantile:.2f} ms")
    axes.axvline(1e3 * accepted, color=LIGHT["reference"], linestyle="--", label=f"accepted: {1e3 * accepted:g} ms")
    axes.legend()
    return figure


@style()
def errors_over_time(record: Mapping[str, np.ndarray], position_error: np.ndarray) -> Figure:
    """Distance of the tip from its target (n,) [m] in every episode; dots where the last command was held."""
    figure, axes = new_plot("time [s]", "position error [mm]", 7.2, 3.5)
    for episode in range(len(record["target"])):
        rows = record["episode"] == episode
        time, error = record["period"][rows] * record["control_period"], 1e3 * position_error[rows]
        name = f"target {episode + 1}" if not record["has_faults"][episode] else "with faults"
        axes.plot(time, error, color=series_colour(episode), label=name)
        held = record["flag"][rows] != 0
        axes.plot(time[held], error[held], ".", color=LIGHT["ink"], markersize=5.0, zorder=3.0)
    axes.set_yscale("log")
    axes.legend(ncols=2)
    return figure
