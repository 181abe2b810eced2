import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named

from qjrl import artifacts
from qjrl.report.canvas import as_png
from qjrl.report.output import write_output
from qjrl.report.tables import as_text
from qjrl.solvers import SolveResult, Status
from qjrl.studies.table3 import figures as solver_figures
from qjrl.studies.table3 import stage as table3
from qjrl.studies.table3.protocol import CaseConfig, Measured, Table3Config, draw_targets
from qjrl.studies.table3.table import metrics_of, numbers_of, published, solver_table

CASE = CaseConfig("qj_22", 30.0)


def result(status, position, orientation, steps):
    count = len(status)
    return SolveResult(
        jnp.zeros((count, 4)),
        jnp.zeros((count, 2, 2)),
        jnp.array(position),
        jnp.array(orientation),
        jnp.array(status) == Status.CONVERGED,
        jnp.array(status),
        jnp.array(steps),
        jnp.zeros(count),
    )


def measured():
    """Two seeds of two targets: 1 of 2 reached, then 2 of 2."""
    return Measured(
        CASE.label,
        "FABRIK",
        (
            result([Status.CONVERGED, Status.STALLED], [2e-6, 0.5], [1e-5, 0.1], [10, 40]),
            result([Status.CONVERGED, Status.CONVERGED], [4e-6, 1e-6], [3e-5, 2e-5], [20, 30]),
        ),
        np.array([[0.001, 0.003], [0.002, 0.002]]),
        np.array([0.010, 0.020, 0.090]),
    )


def test_numbers_by_hand():
    numbers = numbers_of(measured())
    assert numbers["num_targets"] == 4
    assert (numbers["success_percent_lowest_seed"], numbers["success_percent"]) == (50.0, 75.0)
    assert numbers["success_percent_highest_seed"] == 100.0
    assert numbers["batch_ms_median"] == pytest.approx(2.0) and numbers["batch_poses_per_second"] == pytest.approx(500)
    assert numbers["single_ms_median"] == pytest.approx(20.0)
    assert numbers["steps_median"] == 25.0
    assert numbers["worst_position_mm"] == pytest.approx(4e-3)  # of what converged: the stalled 500 mm do not count
    assert numbers["worst_orientation_deg"] == pytest.approx(np.degrees(3e-5))
    assert numbers["stalled_percent"] == 25.0 and numbers["outside_limits_percent"] == 0.0


def test_the_published_figures_are_marked_as_theirs():
    rows = published()
    assert [row["success_percent"] for row in rows] == [70.4, 77.6]
    assert all(row["source"].startswith("arXiv:2606.05236") for row in rows)
    text = as_text(solver_table(metrics_of([measured()], {1.0: np.array([0.0, 0.5])})))
    lines = text.splitlines()
    assert "FABRIK (theirs)" in lines[2] and lines[2].endswith("*") and "70.40" in lines[2]
    assert "50.0–100.0" in lines[4] and not lines[4].endswith("*")


def test_targets_lie_in_the_range_asked_for():
    poses, angles = draw_targets(arm_named("qj_22"), CASE, 512, seed=3)
    assert poses.shape == (512, 9)
    assert angles.min() >= 0.0 and np.radians(29.0) < angles.max() <= np.radians(30.0)
    again, _ = draw_targets(arm_named("qj_22"), CASE, 512, seed=4)
    assert not np.allclose(poses, again)


def test_figures_draw():
    one, curves = measured(), {0.5: np.array([0.1, 0.2]), 1.0: np.array([0.2, 0.9])}
    for figure in (
        solver_figures.success_figure(curves, 70.4),
        solver_figures.failures_figure(one),
        solver_figures.success_by_bend_figure(one, np.array([[0.1, 0.2], [0.3, 0.1]]), num_bins=2),
        solver_figures.trade_figure(metrics_of([one], curves)),
    ):
        assert as_png(figure).startswith(b"\x89PNG")


@pytest.mark.slow
def test_the_stage_writes_its_numbers_and_figures(tmp_path):
    settings = Table3Config((CASE,), num_targets=16, num_seeds=1, num_single=1, num_repeats=1, num_curve=16)
    quick = dataclasses.replace(settings.fabrik, outer_iterations=40, batch_size=16)
    config = table3.Config(dataclasses.replace(settings, fabrik=quick, relaxations=(1.0,)), seed=0)
    write_output(table3.run(config, {}, tmp_path), tmp_path)
    methods = artifacts.load(tmp_path / "metrics.json")["cases"][CASE.label]
    assert len(methods) == 5 and methods["least squares"]["success_percent"] == 100.0
    assert {path.name for path in tmp_path.glob("*.png")} == {
        "success.png",
        "failures.png",
        "success_by_bend.png",
        "methods.png",
    }
