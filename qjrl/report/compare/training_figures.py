"""Learning curves from the records of a `progress.jsonl`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from qjrl.report.canvas import logarithmic, new_plot, style
from qjrl.report.palette import LIGHT, series_colour

Records = Sequence[Mapping[str, Any]]


@style()
def learning_curves(
    records: Records,
    keys: Mapping[str, str],
    x_key: str,
    x_label: str,
    y_label: str,
    is_logarithmic: bool = False,
    references: Mapping[str, float] | None = None,
) -> Figure:
    """One line a key over the course of a training; what a record lacks, or holds as null, is not drawn.

    Args:
        records: lines of a `progress.jsonl`.
        keys: key in the records -> its name in the legend.
        x_key: key of the horizontal axis ("epoch", "env_steps").
        x_label: with its unit, as y_label.
        is_logarithmic: of the vertical axis.
        references: name -> a horizontal line, such as the base controller's error; several take the colours of the keys.
    """
    figure, axes = new_plot(x_label, y_label)
    for index, (key, name) in enumerate(keys.items()):
        steps, values = curve(records, x_key, key)
        if len(steps) == 0:
            continue
        marker = {"marker": "o", "markersize": 4} if len(steps) <= 25 else {}
        axes.plot(steps, values, color=series_colour(index), label=name, **marker)
    for index, (name, value) in enumerate((references or {}).items()):
        colour = LIGHT["reference"] if len(references or {}) == 1 else series_colour(index)
        axes.axhline(value, color=colour, linewidth=1.2, linestyle=(0, (4, 3)), label=name)
    if is_logarithmic:
        logarithmic(axes, "y")
    axes.xaxis.set_major_formatter(lambda value, _: short_count(value))
    if len(keys) + len(references or {}) > 1 and axes.lines:
        axes.legend()
    return figure


def curve(records: Records, x_key: str, y_key: str) -> tuple[np.ndarray, np.ndarray]:
    """The two columns of the records that hold a finite number under both keys."""
    pairs = [
        (record[x_key], record[y_key])
        for record in records
        if _is_number(record.get(x_key)) and _is_number(record.get(y_key))
    ]
    columns = np.array(pairs, np.float64).reshape(-1, 2)
    return columns[:, 0], columns[:, 1]


def short_count(value: float) -> str:
    """A count as people write it on an axis: 800, 50k, 1.5M."""
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:g}{letter}"
    return f"{value:g}"


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and bool(np.isfinite(value))
