"""Stage `elliptical_deviation`: how far the joint's path leaves the circle, and what that does to the arm."""

import dataclasses
from pathlib import Path

from qjrl import progress
from qjrl.report.output import Drawn, Output
from qjrl.robot import robot_from_mapping
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.stage_config import RobotStageConfig
from qjrl.studies.elliptical_deviation import figures
from qjrl.studies.elliptical_deviation import measure as study


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    simulation: SettleConfig
    elliptical_deviation: study.DeviationConfig


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json` and the figures; tables and verdict are shown."""
    del inputs, out
    robot, settings = robot_from_mapping(config.robot), config.elliptical_deviation
    with progress.track(1 + len(settings.variants), "studying joints") as advance:
        studies = study.study_joints(robot, config.simulation, settings, config.seed, advance)
    found = study.joint_map(robot, settings)
    return Output(
        study.metrics_of(robot, settings, studies, found),
        draw=lambda: Drawn(
            {
                "paths": figures.paths(studies),
                "deviation": figures.deviations(studies, settings),
                "maps": figures.maps(found, studies, settings),
                "tip_shift": figures.tip_shifts(studies, settings),
                "tensions": figures.tensions(studies),
            }
        ),
        shown=(
            study.joint_table(studies, settings),
            study.arm_table(studies, settings),
            study.settled_table(studies),
            study.verdict(robot, settings, studies, found),
        ),
    )
