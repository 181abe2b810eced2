"""Numbers of an outcome: quantiles of the errors, tensions, slack, and whether a residual is worth its base."""

import dataclasses
import math
from collections.abc import Iterable, Sequence

import numpy as np
from scipy import stats

from qjrl.report.outcomes import Outcome, controller_label, target_set_label
from qjrl.report.tables import Column, Table

ALLOWED_RATIO = 1.1
"""Median error of the residual policy over its base's, at most."""
_RESAMPLES = 2000


def summarise(outcome: Outcome) -> dict[str, float]:
    """Metrics of one outcome, flat, for `metrics.json`; units in the names (mm, deg, N; `slack_share` from 0 to 1)."""
    tension = outcome.strand_tension
    return {
        "num_targets": len(outcome.position_error),
        "num_left_out": outcome.num_left_out,
        **quantiles(outcome.position_error_mm, "position", "mm"),
        **quantiles(outcome.orientation_error_deg, "orientation", "deg"),
        "tension_min_N": float(tension.min()),
        "tension_max_N": float(tension.max()),
        "slack_share": float(outcome.is_slack.mean()),
    }


def quantiles(errors: np.ndarray, quantity: str, unit: str) -> dict[str, float]:
    """Median with its 95 % interval, p90, p99 and maximum, named `position_median_mm` and so on.

    Args:
        errors: (n,) in `unit`.
    """
    low, high = median_interval(errors)
    values = {
        "median": np.median(errors),
        "median_low": low,
        "median_high": high,
        "p90": np.quantile(errors, 0.90),
        "p99": np.quantile(errors, 0.99),
        "max": np.max(errors),
    }
    return {f"{quantity}_{name}_{unit}": float(value) for name, value in values.items()}


def median_interval(values: np.ndarray, confidence: float = 0.95) -> tuple[float, float]:
    """Interval that holds the population's median with at least `confidence`, from order statistics.

    No assumption about the distribution and no random numbers; with very few values it is the whole range.
    Source: the number of values below the median is binomial(n, 1/2).
    """
    ordered = np.sort(values)
    rank = int(stats.binom.ppf((1.0 - confidence) / 2.0, len(ordered), 0.5))  # of the lower end, from 1; 0: too few
    first = max(rank - 1, 0)
    return float(ordered[first]), float(ordered[len(ordered) - 1 - first])


def by_target_set(outcomes: Iterable[Outcome]) -> dict[str, dict[str, Outcome]]:
    """Target set -> controller -> outcome, in the order given."""
    grouped: dict[str, dict[str, Outcome]] = {}
    for outcome in outcomes:
        grouped.setdefault(outcome.target_set, {})[outcome.controller] = outcome
    return grouped


def metrics_of(outcomes: Iterable[Outcome]) -> dict[str, dict[str, dict[str, float]]]:
    """Target set -> controller -> metrics: the heart of `compare/metrics.json`."""
    return {
        target_set: {controller: summarise(outcome) for controller, outcome in group.items()}
        for target_set, group in by_target_set(outcomes).items()
    }


def error_table(outcomes: Sequence[Outcome]) -> Table:
    """One row an outcome: quantiles of both errors. The smallest median of every target set is marked."""
    columns = (
        Column("targets"), Column("controller"), Column("n", 0),
        *(Column(name, 2, "mm", group="position error") for name in ("median", "p90", "p99", "max")),
        *(Column(name, 2, "°", group="orientation error") for name in ("median", "p90", "p99", "max")),
    )  # fmt: skip
    names = [f"{quantity}_{statistic}_{unit}" for quantity, unit in (("position", "mm"), ("orientation", "deg"))
             for statistic in ("median", "p90", "p99", "max")]  # fmt: skip
    rows, best = [], _best_rows(outcomes)
    for outcome in outcomes:
        metrics = summarise(outcome)
        labels = (target_set_label(outcome.target_set), controller_label(outcome.controller))
        rows.append((*labels, len(outcome.position_error), *(metrics[name] for name in names)))
    return Table(columns, tuple(rows), marked=best, note="* smallest median position error of its targets")


def tension_table(outcomes: Sequence[Outcome]) -> Table:
    """One row an outcome: strand tensions, slack, and the targets left out."""
    columns = (
        Column("targets"), Column("controller"), *(Column(name, 1, "N", group="strand tension") for name in ("least", "median", "largest")),
        Column("slack strands", 2, "%"), Column("targets left out", 0),
    )  # fmt: skip
    rows = [
        (
            target_set_label(outcome.target_set),
            controller_label(outcome.controller),
            outcome.strand_tension.min(),
            np.median(outcome.strand_tension),
            outcome.strand_tension.max(),
            100.0 * outcome.is_slack.mean(),
            outcome.num_left_out,
        )
        for outcome in outcomes
    ]
    return Table(columns, tuple(rows))


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Whether the residual policy is worth having: its median position error over its base's, by target set."""

    holds: bool | None
    """None where no residual policy was compared, or the targets are too few to tell."""
    headline: str
    """The first line of the report."""
    detail: str
    """The numbers behind it, one sentence."""
    ratios: dict[str, float]
    """Target set -> ratio of the medians."""
    intervals: dict[str, tuple[float, float]]
    """Target set -> 95 % interval of that ratio."""


def evaluate_residual(
    outcomes: Iterable[Outcome], residual: str = "learned_ik+residual", base: str = "learned_ik"
) -> Verdict:
    """Compares the median position errors of a policy and its base on every target set that both have."""
    pairs = {
        target_set: (group[residual].position_error_mm, group[base].position_error_mm)
        for target_set, group in by_target_set(outcomes).items()
        if residual in group and base in group
    }
    if not pairs:
        return Verdict(None, "No residual policy was compared with its base", "", {}, {})
    ratios = {name: _ratio(*map(np.median, pair)) for name, pair in pairs.items()}
    intervals = {name: ratio_interval(*pair) for name, pair in pairs.items()}
    worst = max(ratios.values())
    is_open = worst > ALLOWED_RATIO and all(low <= 1.0 for low, _ in intervals.values())
    if worst <= 1.0:
        headline = "The residual policy is at least as accurate as its base"
    elif worst <= ALLOWED_RATIO:
        headline = f"The residual policy stays within {ALLOWED_RATIO:g} times its base's median error"
    elif is_open:
        headline = (
            f"So few targets do not tell whether the residual policy, at {worst:.2f} times, is worse than its base"
        )
    else:
        headline = f"The residual policy is NOT within {ALLOWED_RATIO:g} times its base's median error"
    numbers = ", ".join(
        f"{target_set_label(name)} {np.median(policy):.2f} mm against {np.median(reference):.2f} mm "
        f"({ratios[name]:.2f} times, {intervals[name][0]:.2f} to {intervals[name][1]:.2f})"
        for name, (policy, reference) in pairs.items()
    )
    detail = f"Median position error with and without it: {numbers}."
    return Verdict(None if is_open else worst <= ALLOWED_RATIO, headline, detail, ratios, intervals)


def ratio_interval(values: np.ndarray, references: np.ndarray, confidence: float = 0.95) -> tuple[float, float]:
    """Interval of median(values) / median(references), by bootstrap over the rows, which are pairs where both have all of them.

    Args:
        values, references: (n,) and (m,) errors in the same unit.
    """
    random = np.random.default_rng(0)
    rows = random.integers(0, len(values), (_RESAMPLES, len(values)))
    other = (
        rows if len(values) == len(references) else random.integers(0, len(references), (_RESAMPLES, len(references)))
    )
    ratios = list(map(_ratio, np.median(values[rows], axis=1), np.median(references[other], axis=1)))
    tail = 50.0 * (1.0 - confidence)
    low, high = np.percentile(ratios, (tail, 100.0 - tail), method="nearest")
    return float(low), float(high)


def _ratio(value: float, reference: float) -> float:
    if reference > 0.0:
        return float(value / reference)
    return 1.0 if value == 0.0 else math.inf


def _best_rows(outcomes: Sequence[Outcome]) -> frozenset[int]:
    medians: dict[str, list[tuple[float, int]]] = {}
    for row, outcome in enumerate(outcomes):
        medians.setdefault(outcome.target_set, []).append((float(np.median(outcome.position_error)), row))
    return frozenset(min(group)[1] for group in medians.values())
