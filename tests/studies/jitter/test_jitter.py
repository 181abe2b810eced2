"""The jitter study: its cases, its moving average, its numbers from made-up motions."""

import json

import numpy as np
import pytest

from qjrl.report.canvas import as_png
from qjrl.report.tables import as_text
from qjrl.robot import load_robot
from qjrl.studies.jitter import figures, report
from qjrl.studies.jitter.cases import (
    HARD,
    SERVOS,
    SERVOS_AS_THEY_ARE,
    JitterConfig,
    all_cases,
    deflected_cases,
    sweeps,
)
from qjrl.studies.jitter.measure import (
    ENGINES,
    Commands,
    Findings,
    Motion,
    draw_commands,
    groups,
    moving_average,
    play_of,
)

CONFIG = JitterConfig(num_poses=2, ramp_time=0.2, hold_time=0.4, window=0.2, averages=(5, 20))


def test_every_case_is_played_once_and_beside_its_like():
    cases = all_cases(CONFIG)
    assert len(set(cases)) == len(cases) == sum(map(len, groups(cases)))
    for group in groups(cases):
        assert len({(case.cables, case.iterations) for case in group}) == 1
    assert set(deflected_cases(CONFIG)) <= set(cases)
    found = sweeps(CONFIG)
    assert found["cables"][HARD] == found["half range, hard rows"]["0.1 mm"] == found["iterations"]["20"]


def test_engines_differ_in_their_tolerance_alone_and_a_sweep_of_it_sets_both():
    robot, cases = load_robot("qj_22"), [sweeps(CONFIG)["cables"][HARD], sweeps(CONFIG)["tolerance"]["0.0001"]]
    commands = draw_commands(robot, CONFIG, seed=0)
    plays = [play_of(robot, CONFIG, cases, commands, engine) for engine in ENGINES]
    assert [play.tolerance.tolist() for play in plays] == [[1e-10, 1e-10, 1e-4, 1e-4], [1e-6, 1e-6, 1e-4, 1e-4]]
    np.testing.assert_array_equal(plays[0].cable_lengths, plays[1].cable_lengths)
    np.testing.assert_array_equal(plays[0].cable_lengths[-1, :2], commands.cable_lengths)
    assert plays[0].cable_lengths.shape == (30, 4, robot.num_cables)


def test_a_moving_average_is_the_mean_of_the_last_steps():
    velocities = np.random.default_rng(0).normal(size=(2, 40, 3))
    found = moving_average(velocities, 7)
    assert found.shape == (2, 34, 3)
    np.testing.assert_allclose(found[:, -1], velocities[:, -7:].mean(axis=1), atol=1e-12)
    np.testing.assert_allclose(found[:, 0], velocities[:, :7].mean(axis=1), atol=1e-12)


@pytest.fixture(scope="module")
def findings():
    """Speeds of 1e-3 rad/s in MJX with limits and in MJX's own step, 1e-7 elsewhere; three iterations diverge."""

    def motion(case, engine):
        is_loud = engine == "MJX" and not (case.cables == "servos" and case.is_balanced)
        speed = np.full(2, np.nan if case.iterations == 3 and case.cables == "limits" else 1e-3 if is_loud else 1e-7)
        return Motion(np.tile(speed[:, None], 150), speed, 3 * speed, np.tile(speed[:, None], 2), np.zeros((2, 3)))

    motions = {case: {engine: motion(case, engine) for engine in ENGINES} for case in all_cases(CONFIG)}
    deflections = {case: np.full((2, 4), 0.002 + case.half_width) for case in deflected_cases(CONFIG)}
    nominal = np.array([[0.003, 0.0, 0.0], [0.0, 0.001, 0.0]])
    return Findings(Commands(np.zeros((2, 4, 2)), np.full((2, 8), 0.01), nominal), motions, deflections)


def test_numbers_say_what_was_measured(findings):
    metrics = report.metrics_of(CONFIG, findings)
    json.dumps(metrics, allow_nan=False)
    cables = metrics["sweeps"]["cables"]
    assert cables[SERVOS]["MJX"] == {"mean": 1e-7, "peak": 3e-7, "diverged": 0, "averaged": [1e-7, 1e-7]}
    assert cables[SERVOS_AS_THEY_ARE]["MJX"]["mean"] == 1e-3
    assert cables[HARD]["from_nominal_mm"] == pytest.approx(2.0)
    assert cables[HARD]["deflection_mm"] == pytest.approx(2.1)
    assert metrics["fastest_cable"] == pytest.approx(0.05)
    lost = metrics["sweeps"]["iterations"]["3"]["MJX"]
    assert lost["mean"] is None and lost["peak"] is None and lost["diverged"] == 2
    assert "servos 1.0e-07 rad/s at rest (met: at most 0.0002)" in metrics["verdict"]
    assert "diverged" in as_text(report.speed_table(metrics))
    assert report.delay_of(5) == pytest.approx(0.008)


def test_a_missed_target_is_said_by_how_much():
    speeds = {engine: {"mean": 1e-3} for engine in ENGINES}
    text = report.verdict({SERVOS: speeds, HARD: speeds, SERVOS_AS_THEY_ARE: speeds})
    assert "missed by a factor of 1e+03: at most 1e-06" in text and "missed by a factor of 5: at most 0.0002" in text


def test_figures_are_drawn_even_of_what_diverged(findings):
    metrics = report.metrics_of(CONFIG, findings)
    for figure in (
        figures.velocity_norms(CONFIG, findings),
        figures.settings_tried(CONFIG, metrics),
        figures.cost_of_width(metrics, CONFIG.force),
    ):
        assert as_png(figure, dpi=40).startswith(b"\x89PNG")


def test_a_window_or_an_average_that_reaches_into_the_motion_is_refused():
    with pytest.raises(ValueError, match="window: got 6"):
        JitterConfig(hold_time=5.0, window=6.0)
    with pytest.raises(ValueError, match=r"averages: got 2000, allowed: up to .* = 1000"):
        JitterConfig(averages=(5, 2000))
