"""Stage `policy`: train the residual policy on the target bank."""

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from qjrl.control.policy_training import PHYSICS_RATES, PolicyConfig, check_training, train_policy
from qjrl.control.target_files import read_targets
from qjrl.learning import processes
from qjrl.measured import read_progress
from qjrl.records import NUMBER, check_record
from qjrl.report.output import Output
from qjrl.robot import robot_from_mapping
from qjrl.simulation.engine import EngineConfig
from qjrl.stage_config import RobotStageConfig

_AT_THE_START = ("evaluation/median_mm", "evaluation/uniform_median_mm", "evaluation/near_home_median_mm")


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    needs = ("build_mjcf",)

    engine: EngineConfig
    policy: PolicyConfig

    def check(self) -> None:
        """The control period holds whole time steps, and the devices share the arms."""
        check_training(self.policy, self.engine)


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`; the training, which goes on from them, writes `checkpoints/`, `progress.jsonl`, `physics_rates.jsonl`,
    `policy.npz` and `.json`."""
    robot = robot_from_mapping(config.robot)
    targets = read_targets(inputs["ik"] / "bank.npz")
    trained = train_policy(robot, config.engine, config.policy, targets, config.seed, out)
    if not processes.is_first():
        return Output()
    records = read_progress(out / "progress.jsonl", "env_steps")
    rates = [record["steps_per_second"] for record in records if "steps_per_second" in record]
    physics = read_progress(out / PHYSICS_RATES, "physics_steps_per_second")
    physics_rate = float(np.median([record["physics_steps_per_second"] for record in physics]))
    evaluated = [record for record in records if _is_finite(record.get("evaluation/median_mm"))]
    check_record(out / "progress.jsonl", records[0], dict.fromkeys(_AT_THE_START, NUMBER), "the log of a training")
    start = "base" if config.policy.ppo.starts_at_zero else "untrained"  # noise on top of the base is not the base
    metrics: dict[str, Any] = {
        "kept_env_steps": min(evaluated, key=lambda record: record["evaluation/median_mm"])["env_steps"],
        "env_steps": records[-1]["env_steps"],
        "num_left_out": trained.left_out,
        "steps_per_second": float(np.median(rates)),
        "physics_steps_per_second": physics_rate,
        "share_of_physics_rate": float(np.median(rates)) / physics_rate,
        "invalid_steps": int(sum(record.get("invalid", 0) for record in records)),
        start: {key: records[0][f"evaluation/{key}"] for key in ("uniform_median_mm", "near_home_median_mm")},
    }
    return Output(metrics, shown=list(_lines(metrics)))


def _lines(metrics: dict[str, Any]) -> Iterator[str]:
    if metrics["kept_env_steps"] == 0:
        baseline = "base" if "base" in metrics else "untrained policy"
        yield f"policy: no trained checkpoint beats the {baseline} on the evaluated targets; the untrained one is kept"
    yield (
        f"policy: {metrics['env_steps']} steps at {metrics['steps_per_second']:.0f}/s, "
        f"{100.0 * metrics['share_of_physics_rate']:.0f} % of the physics' alone, "
        f"{metrics['physics_steps_per_second']:.0f}/s"
    )


def _is_finite(value: float | None) -> bool:
    """False: no episode of that checkpoint was sound; it was not chosen."""
    return value is not None and math.isfinite(value)
