"""Pictures of corrections: error against the number of measurements."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from qjrl.analysis.canvas import logarithmic, new_plot, style
from qjrl.analysis.outcomes import controller_label
from qjrl.analysis.palette import controller_look

# Below lies the accuracy of settling [mm].
_FLOOR = 1e-4


@style()
def errors_by_measurements(errors: Mapping[str, np.ndarray], title: str) -> Figure:
    """Median position error after every number of measurements, with the band up to the 90th percentile.

    Args:
        errors: controller -> (measurements + 1, n) [m]; NaN where the arm did not settle.
        title: what the measurements are like.
    """
    figure, axes = new_plot("measurements and corrections", f"position error [mm], median and 90 % – {title}")
    for index, (name, values) in enumerate(errors.items()):
        median, high = np.maximum(1e3 * np.nanpercentile(values, (50, 90), axis=1), _FLOOR)
        numbers, look = np.arange(len(median)), controller_look(name, index)
        axes.fill_between(numbers, median, high, color=look["color"], alpha=0.15, linewidth=0)
        axes.plot(numbers, median, marker="o", markersize=4, label=controller_label(name), **look)
    axes.set_xticks(np.arange(max(len(values) for values in errors.values())))
    logarithmic(axes, "y")
    axes.legend()
    return figure
