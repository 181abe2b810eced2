"""Figures of the residual study."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from qjrl.report.canvas import logarithmic, new_plot, style
from qjrl.report.outcomes import controller_label
from qjrl.report.palette import LIGHT, controller_look


@style()
def errors_over_time(traces: Mapping[str, np.ndarray], period: float) -> Figure:
    """Median position error over the targets after every control step, and the encoders' floor.

    Args:
        traces: controller, or "floor" -> (steps, n) [m].
        period: of a control step [s].
    """
    figure, axes = new_plot("time since the start, s", "position error, median, mm")
    for index, (name, errors) in enumerate(traces.items()):
        times = period * np.arange(1, len(errors) + 1)
        if name == "floor":
            here = np.isfinite(errors).all(axis=1)
            label, look = (
                "encoder noise, averaged since arrival",
                {"color": LIGHT["reference"], "linestyle": (0, (1, 1.2))},
            )
        else:
            here, label, look = np.ones(len(errors), bool), controller_label(name), controller_look(name, index)
        axes.plot(times[here], 1e3 * np.median(errors[here], axis=1), label=label, **look)
    logarithmic(axes, "y")
    axes.legend()
    return figure
