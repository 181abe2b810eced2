import dataclasses

import numpy as np
import pytest
from settled import ARM, settled_rows

from qjrl import artifacts
from qjrl.learning.fitting import FitConfig
from qjrl.learning.networks import NetworkConfig
from qjrl.report.canvas import as_png
from qjrl.report.tables import as_text
from qjrl.robot.forward_model import ForwardModelConfig
from qjrl.studies.model_study import figures
from qjrl.studies.model_study.latency import LatencyConfig, measure_latency
from qjrl.studies.model_study.measure import ModelStudyConfig, make_plan, run_study
from qjrl.studies.model_study.table import study_table

FIT = FitConfig(epochs=4, batch_size=8, evaluate_every=2)
SMALL = ForwardModelConfig("corrected", NetworkConfig(8, 1, 0, zero_output=True), FIT)
CONFIG = ModelStudyConfig(
    paper=ForwardModelConfig("paper", NetworkConfig(8, 1, 1, zero_output=False), FIT),
    corrected=SMALL,
    sizes=(12, 1000),
    held_out=0.4,
    most_visits=60,
    ablation_rows=12,
    frequencies=(0,),
    blocks=(1,),
    widths=(8,),
    width_rows=12,
    ensemble=2,
    ensemble_rows=12,
    latency=LatencyConfig(single_calls=2, batch_size=8, batch_calls=2),
)


def result(rows, error, **more):
    errors = {f"{name}_{unit}": error for name in ("median", "p90", "p99") for unit in ("mm", "deg")}
    return {"rows": rows, "epochs": 4, "held_out": errors, "fitted": errors, "cpu_seconds": 1.5, **more}


METRICS = {
    "paper": {"10": result(10, 2.0), "100": result(100, 1.0)},
    "corrected": {"10": result(10, 0.5), "100": result(100, 0.2)},
    "coordinates": {"paper": result(10, 2.0), "corrected_from_lengths": result(10, 0.6), "corrected": result(10, 0.5)},
    "frequencies": {"0": result(10, 0.5), "6": result(10, 0.9)},
    "blocks": {"1": result(10, 0.5)},
    "width": {"8": result(10, 0.5), "16": result(10, 0.4)},
    "latency": {"8": result(10, 0.5, single_us=20.0, batch_rows_per_s=1e6)},
    "ensemble": {"2": result(10, 0.4)},
}


def test_the_plan_makes_a_shared_fit_once_and_changes_one_thing_at_a_time():
    plan = make_plan(CONFIG, available=30)
    assert plan["corrected"]["12"] == plan["width"]["8"] == plan["blocks"]["1"] == plan["coordinates"]["corrected"]
    assert list(plan["paper"]) == ["12", "30"]  # a size above what there is becomes it
    wide = make_plan(dataclasses.replace(CONFIG, widths=(64,)), 30)["width"]["64"].config
    back = dataclasses.replace(wide, network=dataclasses.replace(wide.network, width=8))
    assert back == SMALL and wide.network.width == 64


def test_many_rows_get_fewer_epochs_of_the_papers_network():
    epochs = {label: fit.config.fit.epochs for label, fit in make_plan(CONFIG, available=30)["paper"].items()}
    assert epochs == {"12": 4, "30": 2}


def test_fits_that_differ_have_directories_that_differ():
    fits = {fit for part in make_plan(ModelStudyConfig(CONFIG.paper, SMALL), 90_000).values() for fit in part.values()}
    assert len({fit.name for fit in fits}) == len(fits)


def test_the_table_has_a_line_a_fit_and_a_rate_where_one_was_measured():
    lines = as_text(study_table(METRICS)).splitlines()
    assert len(lines) == 2 + sum(len(METRICS[part]) for part in METRICS) + 1
    assert next(line for line in lines if "1,000,000" in line).startswith("latency")


def test_the_figures_can_be_drawn():
    sigma = np.linspace(1e-5, 1e-3, 50)
    evaluated = {"position_sigma": sigma, "position_error": 1.5 * sigma}
    report = {"coverage_90_percent": 90.0, "levels": [0.5, 0.9], "shares": [0.4, 0.9]}
    drawn = [
        *(draw(METRICS) for draw in (figures.learning_curves, figures.ablation, figures.accuracy_against_latency)),
        figures.coverage_curves({"position": report, "orientation": report}),
        figures.errors_against_sigma(evaluated),
    ]
    assert all(len(as_png(figure, dpi=40)) > 1000 for figure in drawn)


def test_latency_is_positive():
    assert all(value > 0 for value in measure_latency(ARM, None, CONFIG.latency).values())


@pytest.mark.slow
def test_a_study_measures_every_fit_and_a_second_run_only_reads(tmp_path):
    metrics, evaluated = run_study(ARM, CONFIG, settled_rows(), 0, tmp_path)
    logs = {path: path.read_bytes() for path in tmp_path.glob("*/progress.jsonl")}
    assert len(logs) == 7  # two sizes of two networks, two other coordinates, the ensemble
    again, _ = run_study(ARM, CONFIG, settled_rows(), 0, tmp_path)
    assert {path: path.read_bytes() for path in logs} == logs
    assert again["corrected"] == metrics["corrected"] and again["uncertainty"] == metrics["uncertainty"]
    assert {len(column) for column in evaluated.values()} == {metrics["held_out_rows"] // 2}
    assert artifacts.load(next(iter(logs)))[-1]["cpu_seconds"] > 0
    study_table(metrics)
    figures.ablation(metrics)
