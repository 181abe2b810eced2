"""Pictures of corrections: error against the number of measurements."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qjrl.report.canvas import PANEL, logarithmic, new_figure, style
from qjrl.report.outcomes import controller_label
from qjrl.report.palette import LIGHT, controller_look

# Below lies the accuracy of settling [mm].
_FLOOR = 1e-4

Runs = Mapping[str, np.ndarray]
"""Controller -> (measurements + 1, n) position errors [m]; NaN where the arm did not settle."""


@style()
def errors_by_measurements(panels: Mapping[str, tuple[Runs, float | None]]) -> Figure:
    """Median position error after every number of measurements, with the band up to the 90th percentile.

    Args:
        panels: what the measurements are like -> errors, and the median error of one measurement [m] or None.
    """
    figure = new_figure(PANEL[0] * len(panels), PANEL[1])
    every = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (title, (runs, noise)) in zip(every, panels.items(), strict=True):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="both")
        axes.tick_params(which="both", length=0)
        axes.set_xlabel("measurements and corrections")
        axes.set_title(f"position error [mm], median and 90 %\nmeasurements: {title}")
        _draw(axes, runs, noise)
    logarithmic(every[0], "y")
    every[0].legend()
    return figure


def _draw(axes: Axes, runs: Runs, noise: float | None) -> None:
    for index, (name, values) in enumerate(runs.items()):
        median, high = np.maximum(1e3 * np.nanpercentile(values, (50, 90), axis=1), _FLOOR)
        numbers, look = np.arange(len(median)), controller_look(name, index)
        axes.fill_between(numbers, median, high, color=look["color"], alpha=0.15, linewidth=0)
        axes.plot(numbers, median, marker="o", markersize=4, label=controller_label(name), **look)
        axes.set_xticks(numbers)
    if noise is not None:
        axes.axhline(1e3 * noise, color=LIGHT["reference"], linewidth=0.8, linestyle=(0, (2, 2)))
        axes.text(0.01, 0.9e3 * noise, "noise of one measurement", ha="left", va="top", fontsize=8.0,
                  color=LIGHT["reference"], transform=axes.get_yaxis_transform())  # fmt: skip
