"""Stage `residual`: what the policy and its baseline do, what makes the base err, and what in the training matters."""

import dataclasses
from pathlib import Path

import numpy as np

from qjrl import progress
from qjrl.control.policy_training import PolicyConfig, check_training
from qjrl.control.target_files import read_targets
from qjrl.control.targets import TARGET_SETS
from qjrl.learning.ppo.policy import load_policy
from qjrl.report.output import Drawn, Output
from qjrl.robot import robot_from_mapping
from qjrl.simulation.engine import EngineConfig
from qjrl.stage_config import RobotStageConfig
from qjrl.studies.residual import figures, tables
from qjrl.studies.residual.measure import (
    ResidualStudyConfig,
    ablate,
    effects,
    make_subject,
    over_time,
    tuning,
)
from qjrl.studies.residual.parameter_effects import one_at_a_time


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    needs = ("build_mjcf",)

    engine: EngineConfig
    policy: PolicyConfig
    residual: ResidualStudyConfig

    def check(self) -> None:
        """The control period holds whole time steps, and the devices share the arms."""
        check_training(self.policy, self.engine)


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`, `traces.npz`, `table.md` and the figures; each ablation has a directory, from which it goes on."""
    robot, settings = robot_from_mapping(config.robot), config.residual
    held_out, bank = (read_targets(inputs["ik"] / name) for name in ("held_out.npz", "bank.npz"))
    subject = make_subject(robot, config.engine, config.policy, held_out, settings.num_targets, config.seed)
    traces = over_time(subject, load_policy(inputs["policy"] / "policy"))
    with progress.track(len(settings.baseline_gains), "the baseline's gain") as advance:
        tuned = tuning(subject, settings.baseline_gains, lambda: advance(1))
    parameters = one_at_a_time(config.policy.environment.randomisation)
    with progress.track(len(parameters), "one parameter at a time") as advance:
        alone = effects(subject, lambda: advance(1))
    with progress.track(len(settings.ablations), "ablations") as advance:
        ablated = ablate(subject, bank, settings, out / "ablations", lambda: advance(1))
    scored = config.policy.environment.scored_steps
    floor = {
        name: 1e3 * float(np.median(traces["floor"][-scored:, subject.targets["target_set"] == index]))
        for index, name in enumerate(TARGET_SETS)
    }
    found = {"floor_mm": floor, "baseline": tuned, "effects": alone, "ablations": ablated}
    written = [
        *([tables.tuning_table(tuned)] if tuned else []),
        tables.effects_table(alone),
        *([tables.ablation_table(ablated)] if ablated else []),
    ]

    def draw() -> Drawn:
        drawn = {}
        for index, name in enumerate(TARGET_SETS):
            of_set = {key: errors[:, subject.targets["target_set"] == index] for key, errors in traces.items()}
            drawn[f"errors_{name}"] = figures.errors_over_time(of_set, config.policy.environment.control_period)
        return Drawn(drawn)

    return Output(
        found,
        {"traces": traces | {"target_set": subject.targets["target_set"]}},
        draw,
        {"table": written},
        shown=(f"residual: encoder noise alone, averaged since arrival: {floor}",),
    )
