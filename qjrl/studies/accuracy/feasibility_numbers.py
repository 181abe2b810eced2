"""Numbers and tables of answers with slack strands and of targets out of reach."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qjrl.report.tables import Column, Table
from qjrl.simulation.settling import SLACK_TENSION
from qjrl.solvers import Status, count_statuses

Arrays = Mapping[str, np.ndarray]


def tension_metrics(arrays: Arrays, least_tension: float) -> dict[str, dict[str, Any]]:
    """ "any" and "wanted" -> shares of answers whose least loaded strand is slack or below what is asked for, predicted and in
    the physics.

    `num_false_...`: answers of which the prediction says so and the physics does not, or the other way round.

    Args:
        least_tension: what the solver of "wanted" asks for, of every strand [N].
    """
    found = {}
    for name in ("any", "wanted"):
        rows = arrays[f"{name}/settled"]
        predicted, real = arrays[f"{name}/least_tension"][rows], arrays[f"{name}/settled_least_tension"][rows]
        found[name] = {
            "statuses": count_statuses(arrays[f"{name}/status"]),
            "least_tension_N": least_tension,
            "num_unsettled": int(np.sum(~rows)),
            "tension_error_max_N": float(np.max(np.abs(predicted - real))),
            "settled_position_median_mm": 1e3 * float(np.median(arrays[f"{name}/settled_position_error"][rows])),
            "settled_position_p99_mm": 1e3 * float(np.quantile(arrays[f"{name}/settled_position_error"][rows], 0.99)),
        }
        for label, bound in (("slack", SLACK_TENSION), ("below_least_tension", least_tension)):
            said, is_so = predicted < bound, real < bound
            found[name][label] = {
                "predicted_share": float(np.mean(said)),
                "settled_share": float(np.mean(is_so)),
                "num_true_positive": int(np.sum(said & is_so)),
                "num_false_positive": int(np.sum(said & ~is_so)),
                "num_false_negative": int(np.sum(~said & is_so)),
                "num_true_negative": int(np.sum(~said & ~is_so)),
            }
    return found


def unreachable_metrics(arrays: Arrays, kinds: Sequence[str], rotation_weight: float) -> dict[str, dict[str, Any]]:
    """Kind -> how the answers ended, how far they are from the best found, how far from the model the arm rests.

    Targets that the thorough search reaches are no longer out of reach: counted, and left out of the rest. Answers are
    compared by what the solver minimises, position and weighted rotation error taken together.

    Args:
        rotation_weight: of the solver [m/rad].
    """
    return {kind: _of_kind(arrays, arrays["kind"] == index, rotation_weight) for index, kind in enumerate(kinds)}


def unreachable_table(metrics: Mapping[str, Mapping[str, Any]]) -> Table:
    """One row a kind."""
    columns = (
        Column("targets"), Column("number", 0), Column("out of reach", 0), Column("flagged nearest", 1, "%"),
        Column("position error, median", 1, "mm"), Column("best found", 1, "mm"), Column("as good as the best", 1, "%"),
        Column("arm from model, median", 3, "mm"), Column("p99", 3, "mm"), Column("unsettled", 0),
    )  # fmt: skip
    keys = (
        "num_targets", "num_out_of_reach", "nearest_percent", "position_median_mm", "best_position_median_mm",
        "as_good_percent", "model_distance_median_mm", "model_distance_p99_mm", "num_unsettled",
    )  # fmt: skip
    return Table(columns, tuple((kind, *(found.get(key) for key in keys)) for kind, found in metrics.items()))


def _of_kind(arrays: Arrays, rows: np.ndarray, rotation_weight: float) -> dict[str, Any]:
    is_out = rows & (arrays["best/status"] != Status.CONVERGED)
    counts = {
        "num_targets": int(rows.sum()),
        "num_out_of_reach": int(is_out.sum()),
        "statuses": count_statuses(arrays["answer/status"][is_out]),
        "num_missed": int(np.sum(rows & ~is_out & (arrays["answer/status"] != Status.CONVERGED))),
    }
    if not is_out.any():
        return counts
    cost, best = (
        np.hypot(arrays[f"{name}/position_error"], rotation_weight * arrays[f"{name}/orientation_error"])[is_out]
        for name in ("answer", "best")
    )
    rests = is_out & arrays["settled"]
    excess = 1e3 * (arrays["answer/position_error"] - arrays["best/position_error"])[is_out]
    return counts | {
        "nearest_percent": 100.0 * float(np.mean(arrays["answer/status"][is_out] == Status.NEAREST)),
        "position_median_mm": 1e3 * float(np.median(arrays["answer/position_error"][is_out])),
        "best_position_median_mm": 1e3 * float(np.median(arrays["best/position_error"][is_out])),
        "position_excess_p90_mm": float(np.quantile(excess, 0.9)),
        "position_excess_max_mm": float(np.max(excess)),
        "as_good_percent": 100.0 * float(np.mean(cost <= 1.001 * best)),
        "weighted_error_ratio_p99": float(np.quantile(cost / best, 0.99)),
        "weighted_error_ratio_max": float(np.max(cost / best)),
        "num_unsettled": int(np.sum(is_out & ~arrays["settled"])),
        **{
            f"model_distance_{name}_mm": 1e3 * float(np.quantile(arrays["model_distance"][rests], share))
            for name, share in (("median", 0.5), ("p90", 0.9), ("p99", 0.99), ("max", 1.0))
            if rests.any()
        },
    }
