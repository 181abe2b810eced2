"""Pictures of what the strands carry at rest: against the pretension, over the tip's places, over single bends, along a path."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qjrl.report.canvas import logarithmic, new_figure, new_plot, style
from qjrl.report.palette import LIGHT, series_colour


@style()
def trade_offs(rows: Sequence[Mapping[str, float]], least_tension: float, chosen: float | None) -> Figure:
    """What a pretension buys and costs, four plots against it.

    Args:
        rows: one a pretension, rising, with the keys of the metrics' `curve`.
        least_tension: asked of every strand [N].
        chosen: the answer [N], if there is one.
    """
    figure = new_figure(10.4, 6.6)
    panels = figure.subplots(2, 2).ravel()
    pretension = [row["pretension"] for row in rows]
    plots = (
        ("least loaded strand of a pose [N]", {"worst pose": "least_tension", "median pose": "median_least_tension"}, 1.0),
        ("share of the poses [%]", {"safe": "safe_share", "with a slack strand": "slack_share",
                                    "at a stop": "stopped_share", "never at rest": "unsettled_share"}, 100.0),
        ("largest over the poses [N]", {"strand tension": "largest_tension", "motor force": "largest_motor_force"}, 1.0),
        ("tip off the closed form [mm]", {"median": "median_off_nominal", "largest": "largest_off_nominal"}, 1e3),
    )  # fmt: skip
    legends = ("upper left", "center right", "upper left", "upper center")
    for axes, (title, lines, scale), place in zip(panels, plots, legends, strict=True):
        for index, (label, key) in enumerate(lines.items()):
            values = [scale * row[key] for row in rows]
            axes.plot(pretension, values, marker="o", markersize=3.5, color=series_colour(index), label=label)
        if chosen is not None:
            axes.axvline(chosen, color=LIGHT["reference"], linewidth=1.2, linestyle=(0, (4, 3)))
        _bare(axes, "pretension at home [N]", title)
        logarithmic(axes, "x")
        axes.legend(loc=place)
    panels[0].axhline(least_tension, color=LIGHT["bad"], linewidth=1.0, linestyle=(0, (1, 1.2)))
    panels[0].annotate(f"{least_tension:g} N asked", (pretension[-1], least_tension), (0, 4),
                       textcoords="offset points", ha="right", fontsize=8.0, color=LIGHT["bad"])  # fmt: skip
    return figure


@style()
def tip_maps(tips: Mapping[str, np.ndarray], tensions: Mapping[str, np.ndarray], least_tension: float) -> Figure:
    """Tension of each pose's least loaded strand where its tip rests, one panel a pretension, the lowest on top.

    Args:
        tips: label -> (n, 3) [m].
        tensions: label -> (n,) [N], NaN where a pose does not settle.
    """
    figure = new_figure(5.2 * len(tips), 5.6)
    panels = figure.subplots(1, len(tips), sharey=True, squeeze=False)[0]
    highest = max(float(np.nanmax(values)) for values in tensions.values())
    points = None
    for axes, (label, tip) in zip(panels, tips.items(), strict=True):
        tension = tensions[label]
        settled = np.flatnonzero(np.isfinite(tension))
        order = settled[np.argsort(-tension[settled])]
        rho, height = 1e3 * np.linalg.norm(tip[:, :2], axis=1), 1e3 * tip[:, 2]
        look = {"cmap": "viridis", "vmin": 0.0, "vmax": highest, "linewidths": 0.0}
        points = axes.scatter(rho[order], height[order], s=22.0, c=tension[order], **look)
        low = order[tension[order] < least_tension]
        axes.scatter(rho[low], height[low], s=34.0, facecolors="none", edgecolors=LIGHT["bad"], linewidths=1.2,
                     label=f"below {least_tension:g} N: {len(low)} of {len(tension)}")  # fmt: skip
        axes.plot(0.0, 0.0, "s", color=LIGHT["ink"], markersize=6.0)
        _bare(axes, "ρ [mm]", f"{label}\nz [mm]")
        axes.set_aspect("equal")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.1))
    figure.colorbar(points, ax=list(panels), label="least loaded strand [N]", shrink=0.8)  # pyright: ignore[reportArgumentType]
    return figure


@style()
def segment_maps(tensions: Mapping[str, np.ndarray], bend_limit_deg: float) -> Figure:
    """Tension of the least loaded strand over the bend of each segment alone, one row of discs a pretension.

    Args:
        tensions: label -> (segments, angles, directions) [N]; angles rise evenly to the limit, directions go once around.
        bend_limit_deg: of a joint [deg], the discs' radius.
    """
    num_segments, num_angles, num_directions = next(iter(tensions.values())).shape
    figure = new_figure(2.7 * num_segments, 2.9 * len(tensions) + 0.3)
    grid = figure.subplots(len(tensions), num_segments, sharex=True, sharey=True, squeeze=False)
    between = bend_limit_deg * (np.arange(1, num_angles) + 0.5) / num_angles
    turns = 2.0 * np.pi * (np.arange(num_directions + 1) - 0.5) / num_directions
    radius, turn = np.meshgrid(np.concatenate([[0.0], between, [bend_limit_deg]]), turns, indexing="ij")
    for panels, (label, values) in zip(grid, tensions.items(), strict=True):
        mesh = None
        for segment, axes in enumerate(panels):
            look = {"cmap": "viridis", "rasterized": True, "vmin": np.nanmin(values), "vmax": np.nanmax(values)}
            mesh = axes.pcolormesh(radius * np.cos(turn), radius * np.sin(turn), values[segment], **look)
            _bare(
                axes,
                "θ cos φ [°]",
                f"segment {segment + 1}, {label}\nθ sin φ [°]" if segment == 0 else f"segment {segment + 1}\n",
            )
            axes.set_aspect("equal")
        figure.colorbar(mesh, ax=list(panels), label="least loaded strand [N]", shrink=0.8)  # pyright: ignore[reportArgumentType]
    return figure


@style()
def along_path(tensions: Mapping[str, np.ndarray], least_tension: float) -> Figure:
    """Tension of the least loaded strand at every row of a path (label -> (n,) [N]); gaps where a row does not settle."""
    figure, axes = new_plot("row of the path", "least loaded strand [N]", 10.4, 3.6)
    for index, (label, values) in enumerate(tensions.items()):
        axes.plot(np.arange(len(values)), values, color=series_colour(index), label=label)
    axes.axhline(least_tension, color=LIGHT["bad"], linestyle=(0, (1, 1.2)), label=f"{least_tension:g} N asked")
    axes.set_ylim(0.0, None)
    axes.legend()
    return figure


def _bare(axes: Axes, x_label: str, title: str) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(length=0)
    axes.grid()
    axes.set_xlabel(x_label)
    axes.set_title(title)
