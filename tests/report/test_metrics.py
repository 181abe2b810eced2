import math

import numpy as np
import pytest

from qjrl.report.metrics import (
    error_table,
    evaluate_residual,
    median_interval,
    metrics_of,
    ratio_interval,
    summarise,
    tension_table,
)
from qjrl.report.outcomes import Outcome
from qjrl.report.tables import Column, Table, as_text


def outcome(controller: str, millimetres, target_set: str = "uniform", degrees=None, **more) -> Outcome:
    millimetres = np.asarray(millimetres, float)
    degrees = millimetres / 10.0 if degrees is None else np.asarray(degrees, float)
    tension = np.tile([0.0, 10.0, 20.0, 30.0], (len(millimetres), 1))
    return Outcome(controller, target_set, millimetres / 1e3, np.radians(degrees), tension, tension < 0.01, **more)


def test_summary_of_hand_numbers():
    metrics = summarise(outcome("nominal", np.arange(101), num_left_out=4))
    assert metrics["num_targets"] == 101
    assert metrics["num_left_out"] == 4
    assert metrics["position_median_mm"] == pytest.approx(50.0)
    assert metrics["position_p90_mm"] == pytest.approx(90.0)
    assert metrics["position_p99_mm"] == pytest.approx(99.0)
    assert metrics["position_max_mm"] == pytest.approx(100.0)
    assert metrics["orientation_median_deg"] == pytest.approx(5.0)
    assert metrics["orientation_max_deg"] == pytest.approx(10.0)
    assert (metrics["tension_min_N"], metrics["tension_max_N"], metrics["slack_share"]) == (0.0, 30.0, 0.25)


def test_median_interval_is_the_one_of_the_tables():
    # n = 10: the 2nd and the 9th of ten hold the median with 97.9 % (Conover, Practical Nonparametric Statistics)
    assert median_interval(np.arange(1, 11)) == (2.0, 9.0)
    assert median_interval(np.array([3.0, 1.0])) == (1.0, 3.0)


def test_median_interval_holds_the_median_as_often_as_it_says():
    draws = np.random.default_rng(0).exponential(size=(2000, 51))
    bounds = np.array([median_interval(draw) for draw in draws])
    share = np.mean((bounds[:, 0] <= math.log(2)) & (math.log(2) <= bounds[:, 1]))
    assert 0.94 < share < 0.985


def test_metrics_are_grouped_by_target_set_then_controller():
    metrics = metrics_of(
        [outcome("nominal", [1.0]), outcome("learned_ik", [2.0]), outcome("nominal", [3.0], "near_home")]
    )
    assert {name: list(group) for name, group in metrics.items()} == {
        "uniform": ["nominal", "learned_ik"],
        "near_home": ["nominal"],
    }
    assert metrics["near_home"]["nominal"]["position_median_mm"] == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("policy", "holds", "words"),
    [(1.9, True, "at least as accurate"), (2.1, True, "within 1.1 times"), (2.3, False, "NOT within 1.1 times")],
)
def test_verdict_says_whether_the_residual_keeps_its_base(policy, holds, words):
    verdict = evaluate_residual([outcome("learned_ik", [2.0]), outcome("learned_ik+residual", [policy])])
    assert verdict.holds is holds
    assert words in verdict.headline
    assert verdict.ratios["uniform"] == pytest.approx(policy / 2.0)
    assert f"{policy:.2f} mm against 2.00 mm" in verdict.detail


def test_verdict_is_that_of_the_worst_target_set():
    good = [outcome("learned_ik", [2.0]), outcome("learned_ik+residual", [1.0])]
    bad = [outcome("learned_ik", [2.0], "near_home"), outcome("learned_ik+residual", [3.0], "near_home")]
    assert evaluate_residual(good + bad).holds is False


def test_a_ratio_that_so_few_targets_cannot_tell_from_one_is_left_open():
    base = np.random.default_rng(0).exponential(size=40)
    policy = np.random.default_rng(1).permutation(1.2 * base)  # the same law but for a fifth, of other targets
    verdict = evaluate_residual([outcome("learned_ik", base), outcome("learned_ik+residual", policy)])
    low, high = verdict.intervals["uniform"]
    assert low < 1.0 < verdict.ratios["uniform"] < high
    assert verdict.holds is None and "do not tell" in verdict.headline
    paired = evaluate_residual([outcome("learned_ik", base), outcome("learned_ik+residual", 1.2 * base)])
    assert paired.intervals["uniform"] == pytest.approx((1.2, 1.2))  # target by target it is a fifth worse
    assert paired.holds is False


def test_the_interval_of_a_ratio_holds_it_as_often_as_it_says():
    random, held = np.random.default_rng(0), 0
    for _ in range(100):
        low, high = ratio_interval(3.0 * random.exponential(size=200), random.exponential(size=200))
        held += low <= 3.0 <= high
    assert 88 <= held <= 100


def test_without_a_policy_there_is_no_verdict():
    assert evaluate_residual([outcome("nominal", [1.0])]).holds is None


def test_a_perfect_base_does_not_divide_by_zero():
    verdict = evaluate_residual([outcome("learned_ik", [0.0]), outcome("learned_ik+residual", [0.1])])
    assert verdict.holds is False
    assert verdict.ratios["uniform"] == math.inf


def test_non_finite_rows_are_refused():
    with pytest.raises(ValueError, match="num_left_out"):
        outcome("nominal", [1.0, math.nan])


def test_rows_must_agree():
    with pytest.raises(ValueError, match="allowed"):
        outcome("nominal", [1.0, 2.0], degrees=[1.0])


def test_the_best_of_each_target_set_is_marked():
    rows = [("nominal", 3.0, "uniform"), ("learned_ik", 2.0, "uniform"), ("nominal", 1.0, "near_home")]
    table = error_table([outcome(name, [error], target_set) for name, error, target_set in rows])
    assert table.marked == {1, 2}
    assert [row[3] for row in table.rows] == pytest.approx([3.0, 2.0, 1.0])


def test_tensions_in_a_table():
    (row,) = tension_table([outcome("nominal", [1.0], num_left_out=2)]).rows
    assert row[2:] == (0.0, 15.0, 30.0, 25.0, 2)


def test_text_table_is_aligned():
    table = Table(
        (Column("arm"), Column("error", 2, "mm")),
        (("short", 0.001), ("a longer name", 1234.5)),
        frozenset({1}),
        "* best",
    )
    assert as_text(table).splitlines() == [
        "arm            error [mm]",
        "─────────────  ──────────",
        "short               <0.01",
        "a longer name    1,234.50 *",
        "* best",
    ]
