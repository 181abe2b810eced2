"""Pictures of errors: cumulative curves, predicted beside real, and against how far an arm reaches or bends."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qjrl.report.canvas import logarithmic, new_plot, style
from qjrl.report.outcomes import Outcome, controller_label
from qjrl.report.palette import LIGHT, controller_look

Quantity = Literal["position", "orientation"]

_UNIT = {"position": "mm", "orientation": "°"}
_SCALE = {"position": 1e3, "orientation": 180.0 / np.pi}
_FLOOR = {"position": 1e-3, "orientation": 1e-3}
"""Smallest error drawn [mm, deg]: below lies the accuracy of settling."""


@style()
def cumulative_errors(outcomes: Sequence[Outcome], quantity: Quantity = "position") -> Figure:
    """Share of targets reached within an error, one line a controller; the dot is the median.

    Args:
        outcomes: of one target set.
        quantity: which of the two errors.
    """
    figure, axes = new_plot(f"{quantity} error [{_UNIT[quantity]}]", "targets with a smaller error [%]")
    for index, outcome in enumerate(outcomes):
        look = controller_look(outcome.controller, index)
        errors = _shown(getattr(outcome, f"{quantity}_error"), quantity)
        _draw_cumulative(axes, errors, label=controller_label(outcome.controller), **look)
    _finish_cumulative(axes)
    return figure


@style()
def predicted_and_real(predicted: np.ndarray, real: np.ndarray, quantity: Quantity = "position") -> Figure:
    """Every IK answer: the error the model predicts across, the error the physics has upwards; equal on the diagonal.

    Args:
        predicted: (n,) [m] or [rad].
        real: (n,) the same targets, [m] or [rad].
    """
    across, up = _shown(predicted, quantity), _shown(real, quantity)
    unit = _UNIT[quantity]
    figure, axes = new_plot(
        f"{quantity} error the model predicts [{unit}]", f"{quantity} error in the physics [{unit}]"
    )
    low, high = min(across.min(), up.min()) / 1.3, max(across.max(), up.max()) * 1.3
    axes.plot([low, high], [low, high], color=LIGHT["muted"], linewidth=1.0, linestyle=(0, (4, 3)))
    axes.plot(
        across, up, "o", color=LIGHT["blue"], alpha=0.45, markersize=4.0, markeredgewidth=0.0, rasterized=len(up) > 3000
    )
    axes.plot(np.median(across), np.median(up), "o", color=LIGHT["orange"], markersize=8.0, label="medians")
    axes.annotate(
        "prediction = reality", (high, high), xytext=(-30, -8), textcoords="offset points", ha="right", fontsize=8,
        color=LIGHT["muted"],
    )  # fmt: skip
    axes.set(xlim=(low, high), ylim=(low, high))
    logarithmic(axes, "x")
    logarithmic(axes, "y")
    axes.legend(loc="lower right")
    return figure


@style()
def error_against(
    where: np.ndarray,
    errors: Mapping[str, np.ndarray],
    x_label: str,
    quantity: Quantity = "position",
    num_bins: int = 8,
) -> Figure:
    """Median error over equally full bins of some property of the targets, with the band of the middle half.

    Args:
        where: (n,) the property, in the unit of its label (a distance from home [mm], a largest bend [°]).
        errors: controller -> (n,) [m] or [rad].
        x_label: with its unit.
    """
    figure, axes = new_plot(x_label, f"{quantity} error [{_UNIT[quantity]}]: median and middle half")
    where = np.asarray(where)
    groups = np.array_split(np.argsort(where), max(1, min(num_bins, len(where) // 8)))
    centres = [np.median(where[group]) for group in groups]
    for index, (name, values) in enumerate(errors.items()):
        shown, look = _shown(values, quantity), controller_look(name, index)
        low, middle, high = np.array([np.quantile(shown[group], (0.25, 0.5, 0.75)) for group in groups]).T
        axes.fill_between(centres, low, high, color=look["color"], alpha=0.15, linewidth=0)
        axes.plot(centres, middle, label=controller_label(name), marker="o", markersize=4, **look)
    logarithmic(axes, "y")
    axes.legend()
    return figure


def _shown(errors: np.ndarray, quantity: Quantity) -> np.ndarray:
    """Errors in the unit of the axis, held above its floor."""
    return np.maximum(np.asarray(errors, np.float64) * _SCALE[quantity], _FLOOR[quantity])


def _draw_cumulative(axes: Axes, errors: np.ndarray, label: str, **look) -> None:
    """A curve of at most 300 points, and a dot at the median."""
    shares = np.linspace(0.0, 1.0, min(len(errors), 300))
    axes.plot(np.quantile(errors, shares), 100.0 * shares, label=label, **look)
    axes.plot(np.median(errors), 50.0, "o", color=look["color"], markersize=6.0, markeredgecolor=LIGHT["paper"])


def _finish_cumulative(axes: Axes) -> None:
    logarithmic(axes, "x")
    axes.set_ylim(0.0, 101.0)
    axes.set_yticks([0, 25, 50, 75, 90, 100])
    figure = axes.get_figure()
    assert figure is not None
    figure.legend(
        loc="outside lower center", ncols=2, fontsize=8.0, handlelength=2.4
    )  # beside the curves there is no room
