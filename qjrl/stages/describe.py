"""Stage `describe`: say what an arm is, from its description, its closed form and a few hundred settled poses."""

import dataclasses
from pathlib import Path

import numpy as np

from qjrl import progress
from qjrl.control.targets import draw_configurations
from qjrl.report.arm_drawing import draw_arm
from qjrl.report.description import description_text
from qjrl.report.output import Output
from qjrl.robot import robot_from_mapping
from qjrl.robot.quaternion_arm.description import require_arm
from qjrl.robot.quaternion_arm.naming import cable_numbers
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.survey import DescribeConfig, survey_kinematics, survey_physics, warnings_about
from qjrl.stage_config import RobotStageConfig


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    simulation: SettleConfig
    describe: DescribeConfig


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`description.json`, `description.txt` and `arm.png`; the text is shown too."""
    del inputs, out
    robot = require_arm(robot_from_mapping(config.robot), "describe")
    kinematics = survey_kinematics(robot)
    with progress.track(config.describe.num_poses, "settling") as advance:
        physics = survey_physics(robot, config.simulation, config.describe, config.seed, advance)
    warnings = warnings_about(robot, kinematics, physics)
    names = list(cable_numbers(robot))
    text = description_text(kinematics, physics, names, warnings)
    bends = np.concatenate(
        [np.zeros((1, robot.num_segments, 2)), draw_configurations(robot, "uniform", 2, config.seed)]
    )
    return Output(
        records={"description": {"kinematics": kinematics, "physics": physics, "warnings": warnings}},
        files={"description.txt": f"{text}\n".encode()},
        figures={"arm": draw_arm(robot, bends)},
        shown=(text,),
    )
