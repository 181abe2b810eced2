"""Stage `model_study`: learning curves, ablation, latency and uncertainty of forward models on one data set."""

import dataclasses
import logging
from pathlib import Path

from qjrl import artifacts
from qjrl.report.canvas import save_png
from qjrl.report.tables import as_text
from qjrl.robot import robot_from_mapping, robot_hash
from qjrl.studies.model_study import figures
from qjrl.studies.model_study.measure import ModelStudyConfig, run_study
from qjrl.studies.model_study.table import study_table

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config:
    robot: dict
    model_study: ModelStudyConfig
    seed: int


def run(config: Config, inputs: dict[str, Path], out: Path) -> None:
    """Write `metrics.json`, `ensemble.npz`, the figures and a directory for every fit; the table goes to the log."""
    robot = robot_from_mapping(config.robot)
    data = artifacts.load(inputs["sample"], robot_hash(robot))
    metrics, evaluated = run_study(robot, config.model_study, data, config.seed, out / "fits")
    artifacts.write_arrays(out / "ensemble.npz", evaluated)
    artifacts.write_json(out / "metrics.json", metrics)
    drawn = {
        "learning_curves": figures.learning_curves(metrics),
        "ablation": figures.ablation(metrics),
        "latency": figures.accuracy_against_latency(metrics),
        "coverage": figures.coverage_curves(metrics["uncertainty"]),
        "sigma": figures.errors_against_sigma(evaluated),
    }
    for name, figure in drawn.items():
        save_png(figure, out / f"{name}.png", dpi=110)
    log.info("%s", as_text(study_table(metrics)))
