"""Pictures of a model study: error against rows, what an ablation changes, error against latency, and an uncertainty."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi

from qjrl.report.canvas import logarithmic, new_plot, style
from qjrl.report.palette import LIGHT, series_colour

_FORMS = {"paper": "paper's network", "corrected": "corrected (ours)"}
_ABLATIONS = {"coordinates": "form", "frequencies": "frequencies", "blocks": "blocks", "width": "width"}
_DASHES = (0, (4, 3))


@style()
def learning_curves(metrics: dict[str, Any]) -> Figure:
    """Held-out position error against rows fitted: medians, and the 99th percentile dashed."""
    figure, axes = new_plot("rows fitted", "held-out position error [mm]: median, dashed: p99")
    for index, (part, label) in enumerate(_FORMS.items()):
        results, colour = list(metrics[part].values()), series_colour(index)
        rows = [result["rows"] for result in results]
        axes.plot(rows, _errors(results, "median_mm"), "o-", markersize=4, color=colour, label=label)
        axes.plot(rows, _errors(results, "p99_mm"), marker="o", markersize=3, linestyle=_DASHES, color=colour)
    logarithmic(axes, "x")
    logarithmic(axes, "y")
    axes.legend()
    return figure


@style()
def ablation(metrics: dict[str, Any]) -> Figure:
    """One bar a fit: the held-out median, with a mark at the median of the rows that were fitted."""
    bars = [(f"{title} {label}", part, result)
            for part, title in _ABLATIONS.items() for label, result in metrics[part].items()]  # fmt: skip
    figure, axes = new_plot(
        "median position error [mm], held out; mark: on fitted rows", "", height=0.5 + 0.26 * len(bars)
    )
    parts, heights = list(_ABLATIONS), -np.arange(len(bars), dtype=float)
    colours = [series_colour(parts.index(part)) for _, part, _ in bars]
    axes.barh(heights, _errors([result for *_, result in bars], "median_mm"), color=colours, height=0.7)
    fitted = [result["fitted"]["median_mm"] for *_, result in bars]
    axes.plot(fitted, heights, "|", color=LIGHT["ink"], markersize=9)
    axes.set_yticks(heights, [label.replace("_", " ") for label, *_ in bars])
    axes.grid(visible=False, axis="y")
    return figure


@style()
def accuracy_against_latency(metrics: dict[str, Any]) -> Figure:
    """Held-out median against the time of one row alone and of one row of a batch, one point a width."""
    figure, axes = new_plot("time of a row [µs]", "held-out median position error [mm]")
    results = metrics["latency"]
    medians = _errors(list(results.values()), "median_mm")
    times = {
        "one row at a time": [result["single_us"] for result in results.values()],
        "in a batch": [1e6 / result["batch_rows_per_s"] for result in results.values()],
    }
    for index, (label, microseconds) in enumerate(times.items()):
        axes.plot(microseconds, medians, "o-", markersize=5, color=series_colour(index), label=label)
        for width, across, up in zip(results, microseconds, medians, strict=True):
            axes.annotate(width, (across, up), xytext=(4, 4), textcoords="offset points", fontsize=8)
    logarithmic(axes, "x")
    logarithmic(axes, "y")
    axes.legend(title="numbers: width")
    return figure


@style()
def coverage_curves(uncertainty: dict[str, Any]) -> Figure:
    """Measured against promised share of errors inside an interval; right on the diagonal."""
    figure, axes = new_plot("promised share [%]", "held-out errors inside the interval [%]")
    axes.plot([0, 100], [0, 100], color=LIGHT["muted"], linewidth=1.0, linestyle=_DASHES)
    for index, (quantity, report) in enumerate(uncertainty.items()):
        levels, shares = (100.0 * np.asarray(report[name]) for name in ("levels", "shares"))
        label = f"{quantity}: {report['coverage_90_percent']:.1f} % at 90 %"
        axes.plot(levels, shares, "o-", markersize=3, color=series_colour(index), label=label)
    axes.legend(loc="upper left")
    return figure


@style()
def errors_against_sigma(evaluated: dict[str, np.ndarray]) -> Figure:
    """Every held-out row: the position error upwards, the predicted deviation across; 90 % should lie below the line."""
    sigma, error = 1e3 * evaluated["position_sigma"], 1e3 * evaluated["position_error"]
    figure, axes = new_plot("predicted standard deviation of an axis [mm]", "position error [mm]")
    axes.plot(sigma, error, "o", color=LIGHT["blue"], alpha=0.3, markersize=2.5, markeredgewidth=0.0, rasterized=True)
    ends = np.array([sigma.min(), sigma.max()])
    axes.plot(ends, float(chi.ppf(0.9, df=3)) * ends, color=LIGHT["orange"], linewidth=1.2, label="90 % interval")
    logarithmic(axes, "x")
    logarithmic(axes, "y")
    axes.legend(loc="upper left")
    return figure


def _errors(results: list[dict[str, Any]], name: str) -> list[float]:
    return [result["held_out"][name] for result in results]
