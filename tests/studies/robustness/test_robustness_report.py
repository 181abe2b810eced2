import numpy as np
import pytest

from qjrl.report.canvas import as_png
from qjrl.report.outcomes import Outcome
from qjrl.report.tables import as_text
from qjrl.studies.robustness.figures import errors_by_disturbance
from qjrl.studies.robustness.report import robustness_metrics, robustness_table

BASE, POLICY = "learned_ik+dither", "learned_ik+dither+residual"


def outcome(controller, target_set, middle_mm):
    errors = 1e-3 * middle_mm * np.linspace(0.0, 2.0, 11)
    return Outcome(controller, target_set, errors, errors, np.ones((11, 8)), np.zeros((11, 8), bool))


def found():
    """The policy halves its base's errors, but for one row."""
    medians = {("as trained", "uniform"): 0.5, ("as trained", "near_home"): 0.5, ("delay", "uniform"): 0.5}
    medians["delay", "near_home"] = 3.0
    return {
        disturbance: [
            outcome(controller, target_set, middle)
            for target_set in ("uniform", "near_home")
            for controller, middle in ((BASE, 1.0), (POLICY, medians[disturbance, target_set]))
        ]
        for disturbance in ("as trained", "delay")
    }


def test_rows_in_which_the_policy_is_worse_than_its_base_are_named():
    metrics = robustness_metrics(found(), POLICY, BASE)
    assert metrics["exceptions"] == [{"disturbance": "delay", "target_set": "near_home", "ratio": 3.0}]
    assert "1 of 4 rows: delay on near home (3.00 times)" in metrics["verdict"]
    assert metrics["policy_over_base"]["delay"]["uniform"] == 0.5
    good = {name: outcomes for name, outcomes in found().items() if name == "as trained"}
    assert robustness_metrics(good, POLICY, BASE)["verdict"].startswith("In none of 2 rows")


def test_the_table_has_median_and_p90_of_every_controller_in_every_row():
    table = robustness_table(found(), POLICY, BASE)
    assert [row[:3] for row in table.rows] == [
        ("uniform bends", "as trained", 11), ("uniform bends", "delay", 11),
        ("near home", "as trained", 11), ("near home", "delay", 11),
    ]  # fmt: skip
    assert table.rows[3][3:] == pytest.approx((1.0, 1.8, 3.0, 5.4))
    assert table.marked == {3} and "3.00" in as_text(table)


def test_the_figure_is_drawn():
    assert as_png(errors_by_disturbance(found(), "uniform")).startswith(b"\x89PNG")
