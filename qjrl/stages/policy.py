"""Stage `policy`: train the residual policy on the target bank."""

import dataclasses
import logging
import math
from pathlib import Path
from typing import Any

import numpy as np

from qjrl import artifacts
from qjrl.control.policy_training import PHYSICS_RATES, PolicyConfig, train_policy
from qjrl.learning import processes
from qjrl.plain_json import numbers_again
from qjrl.robot import robot_from_mapping
from qjrl.simulation.control_period import substeps_of
from qjrl.simulation.engine import EngineConfig

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config:
    robot: dict
    engine: EngineConfig
    policy: PolicyConfig
    seed: int

    def __post_init__(self) -> None:
        substeps_of(self.policy.environment.control_period, self.engine.timestep)


def run(config: Config, inputs: dict[str, Path], out: Path) -> None:
    """Write `checkpoints/`, `progress.jsonl`, `physics_rates.jsonl`, `policy.npz` and `.json`, and `metrics.json`."""
    robot = robot_from_mapping(config.robot)
    targets = artifacts.load(inputs["ik"] / "bank.npz")
    trained = train_policy(robot, config.engine, config.policy, targets, config.seed, out)
    if not processes.is_first():
        return
    records = numbers_again(artifacts.load(out / "progress.jsonl"))
    rates = [record["steps_per_second"] for record in records if "steps_per_second" in record]
    physics_rate = float(
        np.median([record["physics_steps_per_second"] for record in artifacts.load(out / PHYSICS_RATES)])
    )
    judged = [record for record in records if _is_finite(record.get("evaluation/median_mm"))]
    start = "base" if config.policy.ppo.starts_at_zero else "untrained"  # noise on top of the base is not the base
    metrics: dict[str, Any] = {
        "kept_env_steps": min(judged, key=lambda record: record["evaluation/median_mm"])["env_steps"],
        "env_steps": records[-1]["env_steps"],
        "num_left_out": trained.left_out,
        "steps_per_second": float(np.median(rates)),
        "physics_steps_per_second": physics_rate,
        "share_of_physics_rate": float(np.median(rates)) / physics_rate,
        "invalid_steps": int(sum(record.get("invalid", 0) for record in records)),
        start: {key: records[0][f"evaluation/{key}"] for key in ("uniform_median_mm", "near_home_median_mm")},
    }
    artifacts.write_json(out / "metrics.json", metrics)
    if metrics["kept_env_steps"] == 0:
        rival = {"base": "base", "untrained": "untrained policy"}[start]
        log.info("policy: no trained checkpoint beats the %s on the judged targets; the untrained one is kept", rival)
    log.info(
        "policy: %d steps at %.0f/s, %.0f %% of the physics' alone, %.0f/s",
        metrics["env_steps"],
        metrics["steps_per_second"],
        100.0 * metrics["share_of_physics_rate"],
        metrics["physics_steps_per_second"],
    )


def _is_finite(value: float | None) -> bool:
    """False: no episode of that checkpoint was sound; it was not chosen."""
    return value is not None and math.isfinite(value)
