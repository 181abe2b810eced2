"""Outcomes of the `ik` stage's held-out answers: what the physics made of them, controller by controller."""

from collections.abc import Mapping, Sequence

import numpy as np

from qjrl.analysis.outcomes import Outcome
from qjrl.simulation.settling import SLACK_TENSION

# Controller of a report -> prefix of its columns in the answers.
_PREFIXES = {"nominal": "nominal", "learned_ik": "learned"}


def outcomes_of_answers(answers: Mapping[str, np.ndarray], target_sets: Sequence[str]) -> list[Outcome]:
    """Real errors at rest of every controller on every target set; what never settled is counted as left out."""
    outcomes = []
    for index, target_set in enumerate(target_sets):
        is_in_set = answers["target_set"] == index
        for controller, prefix in _PREFIXES.items():
            rows = is_in_set & answers[f"{prefix}_settled"]
            tension = answers[f"{prefix}_strand_tension"][rows]
            outcomes.append(
                Outcome(
                    controller=controller,
                    target_set=target_set,
                    position_error=answers[f"{prefix}_position_error"][rows],
                    orientation_error=answers[f"{prefix}_orientation_error"][rows],
                    strand_tension=tension,
                    is_slack=tension < SLACK_TENSION,
                    num_left_out=int(is_in_set.sum() - rows.sum()),
                )
            )
    return outcomes


def predicted_errors(answers: Mapping[str, np.ndarray], target_sets: Sequence[str]) -> dict[str, dict[str, float]]:
    """What the model believed of its own answers: median errors and share converged, per target set."""
    metrics = {}
    for index, target_set in enumerate(target_sets):
        rows = answers["target_set"] == index
        metrics[target_set] = {
            "position_median_mm": 1e3 * float(np.median(answers["predicted_position_error"][rows])),
            "orientation_median_deg": float(np.degrees(np.median(answers["predicted_orientation_error"][rows]))),
            "converged_share": float(answers["converged"][rows].mean()),
        }
    return metrics
