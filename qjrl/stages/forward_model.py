"""Stage `forward_model`: fit cable lengths -> pose on the settled rows, and say how well it does on held-out ones."""

import dataclasses
from pathlib import Path

from qjrl import artifacts
from qjrl.config import ConfigError
from qjrl.report.output import Output
from qjrl.robot import robot_from_mapping, robot_hash
from qjrl.robot.forward_model import save_forward_model
from qjrl.robot.model_fitting import fit_forward_model
from qjrl.robot.model_kinds import MODEL_KINDS, ModelConfig
from qjrl.stage_config import RobotStageConfig


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    forward_model: ModelConfig

    def check(self) -> None:
        """The kind of model suits the kind of robot."""
        robots, kind = MODEL_KINDS[self.forward_model.kind].robots, self.robot["kind"]
        if robots is not None and kind not in robots:
            others = ", ".join(
                name for name, other in MODEL_KINDS.items() if other.robots is None or kind in other.robots
            )
            raise ConfigError(
                f"forward_model.kind: got {self.forward_model.kind}, allowed for a robot of kind {kind}: {others}"
            )


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
