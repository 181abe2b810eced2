"""Stage `forward_model`: fit cable lengths -> pose on the settled rows, and say how well it does on held-out ones."""

import dataclasses
from pathlib import Path

from qjrl import artifacts
from qjrl.report.output import Output
from qjrl.robot import robot_from_mapping, robot_hash
from qjrl.robot.forward_model import save_forward_model
from qjrl.robot.model_fitting import fit_forward_model
from qjrl.robot.model_kinds import ModelConfig
from qjrl.stage_config import RobotStageConfig


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    forward_model: ModelConfig


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`, `model.npz` and `.json`; a network's fit writes `progress.jsonl` and checkpoints, and goes on from them."""
    robot = robot_from_mapping(config.robot)
    data = artifacts.load(inputs["sample"], robot_hash(robot))
    model, metrics = fit_forward_model(robot, config.forward_model, data, config.seed, out)
    save_forward_model(out / "model", robot, model)
    held_out, nominal = metrics["held_out"], metrics["nominal"]
    line = (
        f"forward_model: held-out median {held_out['median_mm']:.3f} mm and {held_out['median_deg']:.3f} deg "
        f"(nominal closed form: {nominal['median_mm']:.3f} mm, {nominal['median_deg']:.3f} deg)"
    )
    return Output(metrics, shown=(line,))
