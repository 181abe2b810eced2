"""Pictures of the jitter study: velocity over time, settings tried, what a wider range costs."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qjrl.report.canvas import logarithmic, new_figure, new_plot, style
from qjrl.report.palette import LIGHT, series_colour
from qjrl.studies.jitter.cases import DEFAULT, HARD, SERVOS, SERVOS_AS_THEY_ARE, TIMESTEP, JitterConfig, sweeps
from qjrl.studies.jitter.measure import ENGINES, Findings
from qjrl.studies.jitter.report import MOST_AT_REST

_SHOWN = (SERVOS, DEFAULT, HARD, SERVOS_AS_THEY_ARE)
_DASHED = (0, (4, 1.6))
_FLOOR = 1e-9
"""Below it nothing is drawn [rad/s]."""


@style()
def velocity_norms(config: JitterConfig, findings: Findings) -> Figure:
    """Norm of the joint velocities over time of the first command (Fig. 10 of the paper): C MuJoCo beside MJX."""
    figure = new_figure(9.0, 3.8)
    cases, panels = sweeps(config)["cables"], figure.subplots(1, 2, sharey=True)
    for engine, axes in zip(ENGINES, panels, strict=True):
        for index, label in enumerate(_SHOWN):
            if engine == "C MuJoCo" and label == SERVOS_AS_THEY_ARE:
                continue  # the same as the servos
            norm = findings.motions[cases[label]][engine].norm[0]
            times, look = TIMESTEP * np.arange(1, len(norm) + 1), {"color": series_colour(index), "linewidth": 0.9}
            axes.plot(times, np.maximum(norm, _FLOOR), label=label, zorder=3.0 - 0.1 * index, **look)
        _tidy(axes, "time [s]", f"{engine}: norm of the joint velocities [rad/s]")
        axes.set_yscale("log")
        axes.axvline(config.ramp_time, color=LIGHT["muted"], linewidth=0.8, linestyle=(0, (2, 2)))
    handles, labels = panels[1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8.0)
    return figure


@style()
def settings_tried(config: JitterConfig, metrics: dict[str, Any]) -> Figure:
    """Mean |joint velocity| at rest of every case, one line each; open marks diverged, dashed lines are the servos' targets."""
    lines = [(f"{name}: {label}" if name != "cables" else label, case)
             for name, sweep in metrics["sweeps"].items() for label, case in sweep.items()]  # fmt: skip
    heights = -np.arange(len(lines) + len(config.averages), dtype=float)
    figure, axes = new_plot(
        f"mean |joint velocity| at rest [rad/s], {_FLOOR:g} or less at {_FLOOR:g}", "", 7.0, 0.8 + 0.19 * len(heights)
    )
    for index, engine in enumerate(ENGINES):
        means = [case[engine]["mean"] for _, case in lines] + metrics["sweeps"]["cables"][HARD][engine]["averaged"]
        good = np.array([mean is not None for mean in means])
        values = np.array([_FLOOR if mean is None else max(mean, _FLOOR) for mean in means])
        axes.plot(values[good], heights[good], "o", color=series_colour(index), markersize=5, label=engine)
        lost = heights[~good]
        axes.plot(np.ones(len(lost)), lost, "o", color=series_colour(index), markerfacecolor="none", markersize=5)
        axes.axvline(MOST_AT_REST[engine], color=series_colour(index), linewidth=0.8, linestyle=_DASHED)
    names = [name for name, _ in lines] + [f"hard rows, moving average of {width} steps" for width in config.averages]
    axes.set_yticks(heights, names, fontsize=7.5)
    axes.set_xscale("log")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=8.0)
    return figure


@style()
def cost_of_width(metrics: dict[str, Any], force: float) -> Figure:
    """Against half the range: how far the tip gives way to a force, how far it rests off, and how much MJX jitters."""
    figure = new_figure(10.5, 3.6)
    panels = figure.subplots(1, 3)
    titles = (f"tip gives way to {force:g} N [mm]", "tip rests off nominal [mm]", "MJX: mean |joint velocity| [rad/s]")
    readings = (
        lambda case: case["deflection_mm"],
        lambda case: case["from_nominal_mm"],
        lambda case: case["MJX"]["mean"],
    )
    for axes, title, reading in zip(panels, titles, readings, strict=True):
        for index, name in enumerate(("half range, hard rows", "half range, MuJoCo's rows")):
            cases = [case for case in metrics["sweeps"][name].values() if reading(case) is not None]
            widths = [1e3 * case["half_width"] for case in cases]
            label = name.removeprefix("half range, ")
            axes.plot(
                widths,
                [reading(case) for case in cases],
                "o-",
                markersize=4,
                color=series_colour(index + 1),
                label=label,
            )
        servos = reading(metrics["sweeps"]["cables"][SERVOS])
        if servos is not None:
            axes.axhline(servos, color=series_colour(0), linestyle=_DASHED, linewidth=1.2, label="servos")
        _tidy(axes, "half of the range [mm]", title)
        logarithmic(axes, "x")
        axes.set_yscale("log")
    panels[0].legend(fontsize=8.0)
    return figure


def _tidy(axes: Axes, x_label: str, title: str) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="both")
    axes.tick_params(length=0, which="both")
    axes.set_xlabel(x_label)
    axes.set_title(title)
