"""Stage `describe`: say what a robot is, from its description, its closed form and a few hundred settled poses."""

import dataclasses
from pathlib import Path

import numpy as np

from qjrl import progress
from qjrl.control.targets import draw_configurations
from qjrl.report.description import description_text
from qjrl.report.output import Drawn, Output
from qjrl.report.robot_drawing import draw_robot
from qjrl.robot import robot_from_mapping
from qjrl.robot.kinds import kind_of
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.survey import DescribeConfig, survey_kinematics, survey_physics, warnings_about
from qjrl.stage_config import RobotStageConfig


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    simulation: SettleConfig
    describe: DescribeConfig


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`description.json`, `description.txt` and `arm.png` where the kind is drawn; the text is shown too."""
    del inputs, out
    robot = robot_from_mapping(config.robot)
    kinematics = survey_kinematics(robot)
    with progress.track(config.describe.num_poses, "settling") as advance:
        physics = survey_physics(robot, config.simulation, config.describe, config.seed, advance)
    warnings = warnings_about(robot, kinematics, physics)
    text, kind = description_text(robot, kinematics, physics, warnings), kind_of(robot)
    home = np.asarray(kind.home(robot))[None]
    shown = np.concatenate([home, draw_configurations(robot, "uniform", 2, config.seed)])
    return Output(
        records={"description": {"kinematics": kinematics, "physics": physics, "warnings": warnings}},
        files={"description.txt": f"{text}\n".encode()},
        draw=None if kind.drawing is None else lambda: Drawn({"arm": draw_robot(robot, shown)}),
        shown=(text,),
    )
