"""Stage `model_study`: learning curves, ablation, latency and uncertainty of forward models on one data set."""

import dataclasses
from pathlib import Path

from qjrl import artifacts
from qjrl.report.output import Drawn, Output
from qjrl.robot import robot_from_mapping, robot_hash
from qjrl.stage_config import RobotStageConfig
from qjrl.studies.model_study import figures
from qjrl.studies.model_study.measure import ModelStudyConfig, run_study
from qjrl.studies.model_study.table import study_table


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    model_study: ModelStudyConfig


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`, `ensemble.npz` and the figures; every fit has a directory, from which it goes on. The table is shown."""
    robot = robot_from_mapping(config.robot)
    data = artifacts.load(inputs["sample"], robot_hash(robot))
    metrics, evaluated = run_study(robot, config.model_study, data, config.seed, out / "fits")

    def draw() -> Drawn:
        return Drawn(
            {
                "learning_curves": figures.learning_curves(metrics),
                "ablation": figures.ablation(metrics),
                "latency": figures.accuracy_against_latency(metrics),
                "coverage": figures.coverage_curves(metrics["uncertainty"]),
                "sigma": figures.errors_against_sigma(evaluated),
            }
        )

    return Output(metrics, {"ensemble": evaluated}, draw, shown=(study_table(metrics),))
