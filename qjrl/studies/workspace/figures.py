"""Pictures of workspaces: clouds in three projections, sections, convergence, dexterity."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qjrl.report.canvas import logarithmic, new_figure, new_plot, style
from qjrl.report.palette import LIGHT, series_colour
from qjrl.report.robot_drawing import ABOVE, FRONT, View, oblique
from qjrl.studies.workspace.occupancy import RingGrid

_VIEWS = {"oblique": oblique(), "front": FRONT, "above": ABOVE}


@style()
def clouds(rows: Sequence[Mapping[str, tuple[np.ndarray, str]]]) -> Figure:
    """Tips in three projections, one row of plots for each mapping, its clouds over each other in their order.

    Args:
        rows: label -> (points (n, 3) [m], colour's name in the palette).
    """
    figure = new_figure(10.4, 3.6 * len(rows))
    grid = figure.subplots(len(rows), 3, squeeze=False)
    everything = np.concatenate([points for row in rows for points, _ in row.values()])
    for axes_row, row in zip(grid, rows, strict=True):
        for axes, (name, view) in zip(axes_row, _VIEWS.items(), strict=True):
            _draw_clouds(axes, view, row, everything)
            if name == "oblique":
                axes.set_title(" over ".join(list(row)[::-1]), fontsize=9.0)
                _legend(axes, row)
    return figure


def _draw_clouds(axes: Axes, view: View, row: Mapping[str, tuple[np.ndarray, str]], everything: np.ndarray) -> None:
    for points, colour in row.values():
        across, up, depth = view(points).T
        order = np.argsort(depth)
        axes.plot(across[order], up[order], ".", color=LIGHT[colour], markersize=1.3, markeredgewidth=0.0,
                  alpha=0.55, rasterized=True)  # fmt: skip
    seen = view(everything)
    for setter, values in ((axes.set_xlim, seen[:, 0]), (axes.set_ylim, seen[:, 1])):
        setter(values.min() - 20.0, values.max() + 20.0)
    axes.set_aspect("equal")
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(length=0)
    if view.labels is None:
        axes.set_axis_off()
        return
    axes.grid()
    axes.set_xlabel(view.labels[0])
    axes.set_title(view.labels[1])


def _legend(axes: Axes, row: Mapping[str, tuple[np.ndarray, str]]) -> None:
    for label, (_, colour) in row.items():
        axes.plot([], [], "o", color=LIGHT[colour], markersize=5.0, label=label)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, -0.08), fontsize=8.0)


@style()
def sections(regions: Mapping[str, np.ndarray], rings: RingGrid) -> Figure:
    """Outlines of what each arm reaches, in the half plane (rho, z).

    Args:
        regions: label -> (along z, along rho) whether a ring is reached.
    """
    figure, axes = new_plot("ρ [mm]", "z [mm]", 5.6, 6.4)
    rho = 1e3 * rings.cell * (np.arange(-1, rings.num_cells) + 0.5)
    z = 1e3 * rings.cell * (np.arange(2 * rings.num_cells) - rings.num_cells + 0.5)
    for index, (label, region) in enumerate(regions.items()):
        mirrored = np.concatenate([region[:, :1], region], axis=1).astype(float)
        axes.contour(rho, z, mirrored, levels=[0.5], colors=[series_colour(index)], linewidths=1.8)
        axes.plot([], [], color=series_colour(index), label=label)
    axes.plot(0.0, 0.0, "s", color=LIGHT["ink"], markersize=6.0, label="base")
    reached = np.any(list(regions.values()), axis=0)
    rows, columns = np.nonzero(reached)
    axes.set(xlim=(0.0, rho[columns.max() + 1] + 20.0), ylim=(z[rows.min()] - 20.0, z[rows.max()] + 20.0))
    axes.set_aspect("equal")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.06), ncols=2)
    return figure


@style()
def convergence(rows: Mapping[str, Sequence[Mapping[str, float]]], volumes: Mapping[str, float]) -> Figure:
    """Share of the estimated volume that has been seen, against the samples of each law.

    Args:
        rows: label -> records with `samples` and the volume seen by each law [m^3].
        volumes: label -> estimate from all samples [m^3].
    """
    figure, axes = new_plot("poses drawn [millions]", "volume seen, of the estimate [%]")
    for index, (label, records) in enumerate(rows.items()):
        for law, dashes in (("planar", "-"), ("spatial", (0, (4, 1.6)))):
            seen = [100.0 * record[law] / volumes[label] for record in records]
            axes.plot([record["samples"] / 1e6 for record in records], seen, color=series_colour(index), linestyle=dashes,
                      marker="o", markersize=3.5, label=label if law == "planar" else None)  # fmt: skip
    axes.plot([], [], color=LIGHT["muted"], label="solid: planar bends")
    axes.plot([], [], color=LIGHT["muted"], linestyle=(0, (4, 1.6)), label="dashed: spatial bends")
    axes.axhline(100.0, color=LIGHT["reference"], linewidth=1.0)
    logarithmic(axes, "x")
    axes.legend(fontsize=8.0)
    return figure


@style()
def dexterity_maps(shares: Mapping[str, np.ndarray], rings: RingGrid) -> Figure:
    """Share of the orientation bins reached, by ring, one panel an arm.

    Args:
        shares: label -> (along z, along rho), NaN where never reached.
    """
    figure = new_figure(10.4, 4.6)
    panels = figure.subplots(1, len(shares), sharey=True, squeeze=False)[0]
    edges = 1e3 * rings.cell * np.arange(-rings.num_cells, rings.num_cells + 1)
    reached = ~np.isnan(np.stack(list(shares.values()))).all(axis=0)
    rows, columns = np.nonzero(reached)
    mesh = None
    for axes, (label, share) in zip(panels, shares.items(), strict=True):
        look = {"vmin": 0.0, "vmax": 100.0, "cmap": "viridis", "rasterized": True}
        mesh = axes.pcolormesh(edges[rings.num_cells :], edges, 100.0 * share, **look)
        axes.set(
            xlim=(0.0, edges[rings.num_cells + columns.max() + 1]), ylim=(edges[rows.min()], edges[rows.max() + 1])
        )
        axes.set_aspect("equal")
        axes.set_xlabel("ρ [mm]")
        axes.set_title(f"{label}\nz [mm]", fontsize=9.0)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(length=0)
    figure.colorbar(mesh, ax=list(panels), label="orientations reached [%]", shrink=0.8)  # pyright: ignore[reportArgumentType]
    return figure
