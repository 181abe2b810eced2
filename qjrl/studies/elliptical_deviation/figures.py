"""Pictures of the elliptical deviation: the path beside the circle, against the angle, over k and d, at tip and strands."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qjrl.report.canvas import logarithmic, new_figure, new_plot, style
from qjrl.report.palette import LIGHT, series_colour
from qjrl.studies.elliptical_deviation.closed_form import DeviationMap, cancelling_offset, deviation
from qjrl.studies.elliptical_deviation.effects import home_height
from qjrl.studies.elliptical_deviation.measure import DeviationConfig, JointStudy


@style()
def paths(studies: Sequence[JointStudy], exaggeration: float = 5.0) -> Figure:
    """Paths of the upper plate's centre beside the circle of radius H0 (Fig. 11a), deviations enlarged."""
    figure, axes = new_plot("x [mm]", f"z [mm]; deviations {exaggeration:g} times enlarged", 5.2, 4.2)
    half = np.radians(np.linspace(-80.0, 80.0, 400)) / 2.0
    height = home_height(studies[0].robot)
    axes.plot(1e3 * height * np.sin(half), 1e3 * height * np.cos(half), color=LIGHT["reference"], linewidth=1.2,
              linestyle=(0, (4, 3)), label="circle")  # fmt: skip
    for index, one in enumerate(studies):
        radius = height + exaggeration * _deviation(one, 2.0 * half)
        axes.plot(1e3 * radius * np.sin(half), 1e3 * radius * np.cos(half), color=series_colour(index), label=one.label)
    axes.plot(0.0, 0.0, "+", color=LIGHT["ink"], markersize=8.0)
    axes.set_aspect("equal")
    axes.legend(loc="lower center", ncols=2, fontsize=8.0)
    return figure


@style()
def deviations(studies: Sequence[JointStudy], config: DeviationConfig) -> Figure:
    """Deviation against the bend angle (Fig. 11b), the band of low error, and the two angles."""
    figure, axes = new_plot("bend angle θ [°]", "H(θ) - H0 [mm]")
    angles = np.radians(np.linspace(-80.0, 80.0, 321))
    band = 1e3 * config.low_error_share * home_height(studies[0].robot)
    label = f"{100 * config.low_error_share:g} % of H0"
    axes.axhspan(-band, band, color=LIGHT["rule"], alpha=0.6, linewidth=0.0, label=label)
    for index, one in enumerate(studies):
        axes.plot(np.degrees(angles), 1e3 * _deviation(one, angles), color=series_colour(index), label=one.label)
    for angle in (config.near_angle_deg, config.far_angle_deg):
        for sign in (-1.0, 1.0):
            axes.axvline(sign * angle, color=LIGHT["muted"], linewidth=0.8, linestyle=(0, (2, 2)))
    axes.legend(loc="upper center", fontsize=8.0)
    return figure


@style()
def maps(found: DeviationMap, studies: Sequence[JointStudy], config: DeviationConfig) -> Figure:
    """Over k and d: deviation at both angles, and where the low error ends; hatched where section 5.5 describes it."""
    figure = new_figure(11.0, 4.0)
    panels = figure.subplots(1, 3, sharey=True)
    d, k = 1e3 * found.plate_to_pin, 1e3 * found.pin_distance
    for axes, values, angle in zip(
        panels, (found.near, found.far), (config.near_angle_deg, config.far_angle_deg), strict=False
    ):
        largest = float(np.abs(values).max()) * 1e3
        levels = np.linspace(-largest, largest, 21)
        shown = axes.contourf(d, k, 1e3 * values, levels=levels, cmap="PuOr")
        axes.contour(d, k, values, levels=[0.0], colors=[LIGHT["ink"]], linewidths=1.4)
        axes.set_title(f"H - H0 at {angle:g}° [mm]\nk [mm]")
        figure.colorbar(shown, ax=axes, shrink=0.85, format="%.1f")
    ends = np.degrees(np.where(np.isnan(found.low_error_end), np.pi / 2.0, found.low_error_end))
    shown = panels[2].contourf(d, k, ends, levels=np.arange(0.0, 91.0, 10.0), cmap="cividis")
    panels[2].contour(d, k, ends, levels=[config.near_angle_deg], colors=[LIGHT["paper"]], linewidths=1.4)
    panels[2].set_title(f"end of {100 * config.low_error_share:g} % of H0 [°]\nk [mm]")
    figure.colorbar(shown, ax=panels[2], shrink=0.85)
    for axes in panels:
        _mark(axes, found, studies)
    return figure


@style()
def tip_shifts(studies: Sequence[JointStudy], config: DeviationConfig) -> Figure:
    """Share of the workspace whose tip shifts by less."""
    figure, axes = new_plot("tip shift [mm]", "poses that shift by less [%]")
    shares = np.linspace(0.0, 1.0, 200)
    for index, one in enumerate(studies):
        for arm, dashes in ((one.arm_near, (0, (4, 1.6))), (one.arm_far, "-")):
            shift = np.maximum(1e3 * np.quantile(arm.tip_shift, shares), 1e-3)
            label = one.label if dashes == "-" else None
            axes.plot(shift, 100.0 * shares, color=series_colour(index), linestyle=dashes, label=label)
    axes.plot([], [], color=LIGHT["muted"], label=f"solid: bends to {config.far_angle_deg:g}°")
    axes.plot([], [], color=LIGHT["muted"], linestyle=(0, (4, 1.6)), label=f"dashed: to {config.near_angle_deg:g}°")
    logarithmic(axes, "x")
    axes.legend(fontsize=8.0)
    return figure


@style()
def tensions(studies: Sequence[JointStudy]) -> Figure:
    """Every strand of the settled poses: the closed form's tension across, the physics' upwards."""
    figure, axes = new_plot("elastic strands at the settled bends [N]", "strand tension in the physics [N]")
    highest = 1.0
    for index, one in enumerate(studies):
        good = one.settled.converged
        across, up = one.settled.elastic_tension[good].ravel(), one.settled.settled_tension[good].ravel()
        axes.plot(
            across, up, "o", color=series_colour(index), markersize=3.5, markeredgewidth=0.0, alpha=0.6, label=one.label
        )
        highest = max(highest, float(across.max(initial=0.0)), float(up.max(initial=0.0)))
    axes.plot([0.0, highest], [0.0, highest], color=LIGHT["muted"], linewidth=1.0, linestyle=(0, (4, 3)))
    axes.legend(fontsize=8.0)
    return figure


def _deviation(one: JointStudy, angles: np.ndarray) -> np.ndarray:
    joint = one.robot.config.joint
    return deviation(joint.pin_distance, joint.plate_to_pin, home_height(one.robot), angles)


def _mark(axes: Axes, found: DeviationMap, studies: Sequence[JointStudy]) -> None:
    """Where section 5.5 holds, where the quadratic terms cancel, and the joints studied."""
    d, k = 1e3 * found.plate_to_pin, 1e3 * found.pin_distance
    described = found.is_as_described.astype(float)
    axes.contourf(d, k, described, levels=[0.5, 1.5], colors="none", hatches=["////"])
    offsets = [1e3 * cancelling_offset(float(pin), home_height(studies[0].robot)) for pin in found.pin_distance]
    axes.plot(offsets, k, color=LIGHT["reference"], linewidth=1.2, linestyle=(0, (4, 3)))
    for index, one in enumerate(studies):
        joint = one.robot.config.joint
        axes.plot(1e3 * joint.plate_to_pin, 1e3 * joint.pin_distance, "o", color=series_colour(index),
                  markeredgecolor=LIGHT["paper"], markersize=8.0, clip_on=False, zorder=5)  # fmt: skip
    axes.set_xlabel("d [mm]")
    axes.set(xlim=(d[0], d[-1]), ylim=(k[0], k[-1]))
