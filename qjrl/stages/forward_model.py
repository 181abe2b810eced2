"""Stage `forward_model`: fit cable lengths -> pose on the settled rows, and say how well it does on held-out ones."""

import dataclasses
import logging
from pathlib import Path

from qjrl import artifacts
from qjrl.robot import robot_from_mapping, robot_hash
from qjrl.robot.forward_model import ForwardModelConfig, save_forward_model
from qjrl.robot.model_fitting import fit_forward_model

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config:
    robot: dict
    forward_model: ForwardModelConfig
    seed: int


def run(config: Config, inputs: dict[str, Path], out: Path) -> None:
    """Write `model.npz` and `.json`, `progress.jsonl`, checkpoints and `metrics.json`."""
    robot = robot_from_mapping(config.robot)
    data = artifacts.load(inputs["sample"], robot_hash(robot))
    model, metrics = fit_forward_model(robot, config.forward_model, data, config.seed, out)
    save_forward_model(out / "model", robot, model)
    artifacts.write_json(out / "metrics.json", metrics)
    log.info(
        "forward_model: held-out median %.3f mm and %.3f deg (nominal closed form: %.3f mm, %.3f deg)",
        metrics["held_out"]["median_mm"],
        metrics["held_out"]["median_deg"],
        metrics["nominal"]["median_mm"],
        metrics["nominal"]["median_deg"],
    )
