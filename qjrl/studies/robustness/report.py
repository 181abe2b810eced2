"""The study of disturbances in numbers: `metrics.json`, its table, the verdict."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from qjrl.report.metrics import by_target_set, metrics_of
from qjrl.report.outcomes import Outcome, controller_label, target_set_label
from qjrl.report.tables import Cell, Column, Table

Disturbed = Mapping[str, Sequence[Outcome]]
"""Disturbance -> outcomes of the same controllers and target sets."""


def robustness_metrics(found: Disturbed, policy: str, base: str) -> dict[str, Any]:
    """Everything measured, for `metrics.json`; `exceptions` are the rows in which the policy is worse than its base."""
    ratios: dict[str, dict[str, float]] = {}
    for disturbance, target_set, group in _rows(found):
        ratios.setdefault(disturbance, {})[target_set] = _median(group[policy]) / _median(group[base])
    exceptions = [
        {"disturbance": disturbance, "target_set": target_set, "ratio": ratio}
        for disturbance, sets in ratios.items()
        for target_set, ratio in sets.items()
        if ratio > 1.0
    ]
    return {
        "verdict": verdict(exceptions, sum(map(len, ratios.values()))),
        "exceptions": exceptions,
        "policy_over_base": ratios,
        "disturbances": {disturbance: metrics_of(outcomes) for disturbance, outcomes in found.items()},
    }


def verdict(exceptions: Sequence[Mapping[str, Any]], num_rows: int) -> str:
    """In words: where the policy's median error exceeds its base's."""
    if not exceptions:
        return f"In none of {num_rows} rows does the policy's median error exceed its base's."
    named = ", ".join(
        f"{one['disturbance']} on {target_set_label(one['target_set'])} ({one['ratio']:.2f} times)"
        for one in exceptions
    )
    return f"The policy's median error exceeds its base's in {len(exceptions)} of {num_rows} rows: {named}."


def robustness_table(found: Disturbed, policy: str, base: str) -> Table:
    """One row a target set and disturbance, median and p90 of every controller; rows of the exceptions are marked."""
    controllers = list(dict.fromkeys(outcome.controller for outcomes in found.values() for outcome in outcomes))
    columns = [Column("targets"), Column("disturbance"), Column("n", 0)]
    for name in controllers:
        label = controller_label(name)
        columns += [Column(f"{label}: median", 2, "mm", group=label), Column("p90", 2, "mm", group=label)]
    rows, marked = [], []
    for disturbance, target_set, group in sorted(_rows(found), key=lambda row: row[1], reverse=True):
        if _median(group[policy]) > _median(group[base]):
            marked.append(len(rows))
        cells: list[Cell] = [target_set_label(target_set), disturbance, len(group[base].position_error)]
        for name in controllers:
            cells += [_median(group[name]), float(np.quantile(group[name].position_error_mm, 0.9))]
        rows.append(tuple(cells))
    note = "position error; bold or *: the policy's median exceeds its base's"
    return Table(tuple(columns), tuple(rows), marked=frozenset(marked), note=note)


def _rows(found: Disturbed) -> Iterator[tuple[str, str, dict[str, Outcome]]]:
    for disturbance, outcomes in found.items():
        for target_set, group in by_target_set(outcomes).items():
            yield disturbance, target_set, group


def _median(outcome: Outcome) -> float:
    return float(np.median(outcome.position_error_mm))
