"""Pictures of a followed path: the path with the deviations magnified, errors over time, the cables against their limits."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qjrl.report.canvas import new_figure, new_plot, style
from qjrl.report.palette import LIGHT, SERIES, series_colour
from qjrl.report.track.tracked import Tracked

_VIEWS = (("x", "y", 0, 1), ("x", "z", 0, 2), ("y", "z", 1, 2))


def track_pictures(
    positions: tuple[np.ndarray, np.ndarray],
    runs: Mapping[str, Tracked],
    cables: Sequence[np.ndarray],
    bounds: Sequence[float],
    names: Sequence[str],
) -> dict[str, tuple[Figure, str]]:
    """File name -> figure and caption.

    Args:
        positions: planned and played (n, 3) [m].
        runs: with "planned" among them.
        cables: times (n,), then speed, acceleration and jerk (n, cables).
        bounds: of speed, acceleration and jerk.
        names: of the cables.
    """
    main = runs["planned"]
    shown = {name: runs[name] for name in ("planned", "without lead", "closed form") if name in runs}
    return {
        "path": (path_views(*positions), "The path and where the tip went, its deviations magnified."),
        "cables": (
            cables_over_time(cables[0], cables[1:], bounds, names),
            "Every cable against its limits (dashed), at the speed that is played.",
        ),
        "error": (errors_over_time(shown), "Distance of the tip from where it should be now."),
        "orientation": (orientation_over_time(main), "Orientation of the tip against the plan's."),
        "tension": (tensions_over_time(main), "The least and the largest tension of all strands while the arm moves."),
    }


@style()
def path_views(planned: np.ndarray, played: np.ndarray) -> Figure:
    """Planned and played positions (n, 3) [m] from three sides, deviations magnified by the number in the title."""
    size = float(np.ptp(planned, axis=0).max())
    worst = max(float(np.linalg.norm(played - planned, axis=1).max()), 1e-12)
    factor = max(1.0, float(f"{0.1 * size / worst:.1g}"))
    shown = planned + factor * (played - planned)
    figure = new_figure(10.4, 3.6)
    for index, (across, up, i, j) in enumerate(_VIEWS):
        axes = _panel(figure.add_subplot(1, 3, index + 1), f"{across} [mm]", f"{up} [mm]")
        axes.plot(1e3 * planned[:, i], 1e3 * planned[:, j], color=LIGHT["reference"], linewidth=1.2, label="planned")
        axes.plot(
            1e3 * shown[:, i],
            1e3 * shown[:, j],
            color=LIGHT["blue"],
            linewidth=1.4,
            label=f"played, deviations × {factor:g}",
        )
        axes.set_aspect("equal", adjustable="datalim")
        if index == 0:
            axes.legend(loc="center", fontsize=8)
    return figure


@style()
def errors_over_time(runs: dict[str, Tracked]) -> Figure:
    """Position error of the tip over the plan, of the first run also its part across the path."""
    figure, axes = new_plot("time [s]", "position error [mm]", 7.2, 3.5)
    for index, (name, run) in enumerate(runs.items()):
        axes.plot(run.time, 1e3 * run.position, color=series_colour(index), label=name)
        if index == 0:
            axes.plot(
                run.time, 1e3 * run.across, color=series_colour(index), linestyle=(0, (1, 1.2)), label=f"{name}, across"
            )
    axes.set_ylim(bottom=0.0)
    axes.legend()
    return figure


@style()
def orientation_over_time(run: Tracked) -> Figure:
    """Orientation error of the tip over the plan."""
    figure, axes = new_plot("time [s]", "orientation error [°]")
    axes.plot(run.time, np.degrees(run.orientation), color=LIGHT["blue"])
    axes.set_ylim(bottom=0.0)
    return figure


@style()
def cables_over_time(
    times: np.ndarray, derivatives: Sequence[np.ndarray], bounds: Sequence[float], names: Sequence[str]
) -> Figure:
    """Speed, acceleration and jerk of every cable over time, each with its bounds dashed.

    Args:
        times: (n,) [s].
        derivatives: three arrays (n, cables) [m/s, m/s^2, m/s^3].
        bounds: of each.
        names: of the cables.
    """
    figure = new_figure(10.4, 3.4)
    labels = ("cable speed [mm/s]", "acceleration [mm/s²]", "jerk [mm/s³]")
    for index, (values, bound, label) in enumerate(zip(derivatives, bounds, labels, strict=True)):
        axes = _panel(figure.add_subplot(1, 3, index + 1), "time [s]", label)
        for cable, name in enumerate(names):
            dashes = "-" if cable < len(SERIES) else (0, (4, 1.6))  # where colours come again
            axes.plot(
                times, 1e3 * values[:, cable], linestyle=dashes, color=series_colour(cable), linewidth=1.1, label=name
            )
        for sign in (-1.0, 1.0):
            axes.axhline(sign * 1e3 * bound, color=LIGHT["bad"], linewidth=1.2, linestyle=(0, (4, 3)))
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(names), fontsize=8.0
    )
    return figure


@style()
def tensions_over_time(run: Tracked) -> Figure:
    """The least and the largest tension of all strands over the plan."""
    figure, axes = new_plot("time [s]", "tension of the strands [N]")
    least, most = run.strand_tension.min(axis=1), run.strand_tension.max(axis=1)
    axes.fill_between(run.time, least, most, color=LIGHT["teal"], alpha=0.2, linewidth=0)
    axes.plot(run.time, least, color=LIGHT["teal"], label="least")
    axes.plot(run.time, most, color=LIGHT["teal"], linestyle=(0, (4, 1.6)), label="largest")
    axes.set_ylim(bottom=0.0)
    axes.legend()
    return figure


def _panel(axes: Axes, x_label: str, y_label: str) -> Axes:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid()
    axes.tick_params(length=0)
    axes.set_xlabel(x_label)
    axes.set_title(y_label)
    return axes
