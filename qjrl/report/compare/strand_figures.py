"""Pictures of what the strands carry."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from qjrl.report.canvas import new_plot, style
from qjrl.report.outcomes import Outcome, controller_label
from qjrl.report.palette import LIGHT, controller_look


@style()
def tension_histogram(outcomes: Sequence[Outcome], pretension: float | None = None, num_bins: int = 48) -> Figure:
    """How often a strand carries how much, one outline a controller; slack strands are named in the legend.

    Args:
        outcomes: of one target set.
        pretension: marks the tension at home [N].
    """
    figure, axes = new_plot("strand tension [N]", "share of the strands [%]")
    everything = np.concatenate([outcome.strand_tension.ravel() for outcome in outcomes])
    edges = np.linspace(0.0, max(float(np.quantile(everything, 0.999)), 1e-9), num_bins + 1)
    for index, outcome in enumerate(outcomes):
        look = controller_look(outcome.controller, index)
        taut = np.minimum(outcome.strand_tension[~outcome.is_slack], edges[-1])
        shares = 100.0 * np.histogram(taut, edges)[0] / outcome.strand_tension.size
        label = f"{controller_label(outcome.controller)}: {100.0 * outcome.is_slack.mean():.2g} % slack"
        axes.stairs(shares, edges, baseline=None, linewidth=1.6, label=label, **look)
    if pretension is not None:
        axes.axvline(
            pretension,
            color=LIGHT["reference"],
            linewidth=1.2,
            linestyle=(0, (4, 3)),
            label=f"at home: {pretension:g} N",
        )
    axes.set(xlim=(0.0, edges[-1]), ylim=(0.0, None))
    axes.legend()
    return figure
