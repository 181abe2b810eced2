"""The picture of the study: every controller's error under every disturbance."""

import numpy as np
from matplotlib.figure import Figure

from qjrl.report.canvas import logarithmic, new_plot, style
from qjrl.report.metrics import by_target_set
from qjrl.report.outcomes import Outcome, controller_label
from qjrl.report.palette import LIGHT, controller_look
from qjrl.studies.robustness.report import Disturbed


@style()
def errors_by_disturbance(found: Disturbed, target_set: str) -> Figure:
    """One line a disturbance and controller: a dot at the median, a line to p90."""
    groups = [(name, by_target_set(outcomes)[target_set]) for name, outcomes in found.items()]
    controllers = list(groups[0][1])
    figure, axes = new_plot("position error, median and p90 [mm]", "", 7.0, 1.0 + 0.5 * len(groups))
    apart = 0.7 / len(controllers)
    for index, controller in enumerate(controllers):
        heights = -np.arange(len(groups)) - apart * (index - 0.5 * (len(controllers) - 1))
        middle, high = np.array([_quantiles(group[controller]) for _, group in groups]).T
        look = controller_look(controller, index)
        axes.hlines(heights, middle, high, linewidth=1.5, **look)
        fill = look["color"] if look["linestyle"] == "-" else LIGHT["paper"]  # open marks where the line is broken
        label = controller_label(controller)
        axes.plot(middle, heights, "o", color=look["color"], markerfacecolor=fill, markersize=5, label=label)
    for edge in range(1, len(groups)):
        axes.axhline(0.5 - edge, color=LIGHT["rule"], linewidth=0.8)
    axes.set_yticks(-np.arange(len(groups)), [name for name, _ in groups])
    axes.grid(axis="y", visible=False)
    logarithmic(axes, "x")
    figure.legend(loc="outside lower center", ncols=2, fontsize=8.0)
    return figure


def _quantiles(outcome: Outcome) -> np.ndarray:
    return np.quantile(outcome.position_error_mm, (0.5, 0.9))
