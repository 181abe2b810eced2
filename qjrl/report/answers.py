"""Outcomes of the `ik` stage's held-out answers: what the physics made of them, controller by controller."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qjrl.report.outcomes import Outcome
from qjrl.simulation.settling import SLACK_TENSION
from qjrl.solvers import count_statuses

# Controller of a report -> prefix of its columns in the answers.
_PREFIXES = {"nominal": "nominal", "learned_ik": "learned"}


def outcomes_of_answers(answers: Mapping[str, np.ndarray], target_sets: Sequence[str]) -> list[Outcome]:
    """Real errors at rest of every controller on every target set; what never settled is counted as left out."""
    outcomes = []
    for index, target_set in enumerate(target_sets):
        rows = answers["target_set"] == index
        for controller, prefix in _PREFIXES.items():
            names = ("position_error", "orientation_error", "strand_tension", "settled")
            columns = (answers[f"{prefix}_{name}"][rows] for name in names)
            outcomes.append(outcome_at_rest(controller, target_set, *columns))
    return outcomes


def outcome_at_rest(
    controller: str,
    target_set: str,
    position_error: np.ndarray,
    orientation_error: np.ndarray,
    strand_tension: np.ndarray,
    has_settled: np.ndarray,
) -> Outcome:
    """Outcome of commands that were settled; what never settled is counted as left out.

    Args:
        position_error: (n,) [m]; orientation_error: (n,) [rad]; strand_tension: (n, strands) [N]; has_settled: (n,).
    """
    at_rest = {
        "position_error": position_error[has_settled],
        "orientation_error": orientation_error[has_settled],
        "strand_tension": strand_tension[has_settled],
    }
    return outcome_of(controller, target_set, **at_rest, num_left_out=int(len(has_settled) - has_settled.sum()))


def outcome_of(
    controller: str,
    target_set: str,
    position_error: np.ndarray,
    orientation_error: np.ndarray,
    strand_tension: np.ndarray,
    num_left_out: int,
) -> Outcome:
    """Outcome with the strands that carry no tension told apart.

    Args:
        position_error: (n,) [m]; orientation_error: (n,) [rad]; strand_tension: (n, strands) [N].
    """
    is_slack = strand_tension < SLACK_TENSION
    return Outcome(controller, target_set, position_error, orientation_error, strand_tension, is_slack, num_left_out)


def predicted_errors(answers: Mapping[str, np.ndarray], target_sets: Sequence[str]) -> dict[str, dict[str, Any]]:
    """What the solver believed of its own answers: median errors, how they ended, share with a slack strand, per target set."""
    metrics = {}
    for index, target_set in enumerate(target_sets):
        rows = answers["target_set"] == index
        metrics[target_set] = {
            "position_median_mm": 1e3 * float(np.median(answers["predicted_position_error"][rows])),
            "orientation_median_deg": float(np.degrees(np.median(answers["predicted_orientation_error"][rows]))),
            "converged_share": float(answers["converged"][rows].mean()),
            "statuses": count_statuses(answers["status"][rows]),
            "slack_share": float(np.mean(answers["least_tension"][rows] < SLACK_TENSION)),
        }
    return metrics
