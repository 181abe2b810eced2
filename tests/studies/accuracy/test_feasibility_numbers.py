import numpy as np
import pytest

from qjrl.report.tables import as_markdown
from qjrl.solvers import Status, count_statuses
from qjrl.studies.accuracy.feasibility_numbers import tension_metrics, unreachable_metrics, unreachable_table


def test_statuses_are_counted_by_name_and_what_does_not_occur_is_left_out():
    assert count_statuses(np.array([0, 4, 0, 0])) == {"converged": 3, "nearest": 1}


def test_predictions_are_held_against_the_physics():
    one = {
        "status": np.zeros(5, int),
        "settled": np.array([True, True, True, True, False]),
        "least_tension": np.array([0.0, 0.0, 1.0, 3.0, 0.0]),
        "settled_least_tension": np.array([0.0, 0.02, 0.0, 3.1, 0.0]),
        "settled_position_error": np.array([1e-3, 2e-3, 3e-3, 4e-3, 1.0]),
    }
    arrays = {f"{name}/{key}": value for name in ("any", "wanted") for key, value in one.items()}
    found = tension_metrics(arrays, 2.0)["any"]
    assert found["statuses"] == {"converged": 5} and found["num_unsettled"] == 1
    assert found["tension_error_max_N"] == pytest.approx(1.0) and found["settled_position_median_mm"] == pytest.approx(
        2.5
    )
    slack = found["slack"]
    assert [
        slack[f"num_{kind}"] for kind in ("true_positive", "false_positive", "false_negative", "true_negative")
    ] == [1] * 4
    for bound, said, is_so in (
        (2.0, 0.75, 0.75),
        (4.0, 1.0, 1.0),
        (0.5, 0.5, 0.75),
    ):  # the solver's, no bound of the report's own
        below = tension_metrics(arrays, bound)["any"]["below_least_tension"]
        assert (below["predicted_share"], below["settled_share"]) == (said, is_so), bound


ARRAYS = {
    "kind": np.array([0, 0, 0, 1, 1]),
    "answer/status": np.array([Status.NEAREST, Status.NEAREST, Status.STALLED, Status.CONVERGED, Status.NEAREST]),
    "best/status": np.array([Status.NEAREST] * 3 + [Status.CONVERGED] * 2),
    "answer/position_error": np.array([0.03, 0.05, 0.04, 0.0, 0.01]),
    "answer/orientation_error": np.array([0.4, 0.0, 0.3, 0.0, 0.1]),  # weighted: 0.05, 0.05, 0.05
    "best/position_error": np.array([0.03, 0.025, 0.04, 0.0, 0.0]),
    "best/orientation_error": np.array([0.4, 0.0, 0.3, 0.0, 0.0]),
    "settled": np.array([True, True, False, True, True]),
    "model_distance": np.array([1e-3, 3e-3, 1.0, 1e-3, 1e-3]),
}


def test_answers_out_of_reach_are_held_against_the_best_that_is_known():
    far = unreachable_metrics(ARRAYS, ("far", "turned"), 0.1)["far"]
    assert far["num_targets"] == far["num_out_of_reach"] == 3 and far["statuses"] == {"stalled": 1, "nearest": 2}
    assert far["nearest_percent"] == pytest.approx(200 / 3) and far["as_good_percent"] == pytest.approx(200 / 3)
    assert far["weighted_error_ratio_max"] == pytest.approx(2.0) and far["position_excess_max_mm"] == pytest.approx(
        25.0
    )
    assert far["model_distance_median_mm"] == pytest.approx(2.0) and far["num_unsettled"] == 1


def test_what_a_thorough_search_reaches_is_not_out_of_reach():
    metrics = unreachable_metrics(ARRAYS, ("far", "turned"), 0.1)
    turned = metrics["turned"]
    assert turned == {"num_targets": 2, "num_out_of_reach": 0, "statuses": {}, "num_missed": 1}
    lines = as_markdown(unreachable_table(metrics)).splitlines()
    assert "| far | 3 | 3 | 66.7 |" in lines[2] and lines[3].startswith("| turned | 2 | 0 | – |")
