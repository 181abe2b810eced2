"""Stage `residual`: what the policy and its baseline do, what makes the base err, and what in the training matters."""

import dataclasses
import logging
from pathlib import Path

import numpy as np

from qjrl import artifacts, progress
from qjrl.control.policy_training import PolicyConfig, check_training
from qjrl.control.target_files import read_targets
from qjrl.control.targets import TARGET_SETS
from qjrl.learning.ppo.policy import load_policy
from qjrl.report.canvas import save_png
from qjrl.report.tables import as_markdown, as_text
from qjrl.robot import robot_from_mapping
from qjrl.simulation.engine import EngineConfig
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

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config:
    robot: dict
    engine: EngineConfig
    policy: PolicyConfig
    residual: ResidualStudyConfig
    seed: int

    def check(self) -> None:
        """The control period holds whole time steps, and the devices share the arms."""
        check_training(self.policy, self.engine)


def run(config: Config, inputs: dict[str, Path], out: Path) -> None:
    """Write `metrics.json`, `traces.npz`, `table.md`, the figures, and a directory for each ablation."""
    robot, settings = robot_from_mapping(config.robot), config.residual
    held_out, bank = (read_targets(inputs["ik"] / name) for name in ("held_out.npz", "bank.npz"))
    subject = make_subject(robot, config.engine, config.policy, held_out, settings.num_targets, config.seed)
    traces = over_time(subject, load_policy(inputs["policy"] / "policy"))
    artifacts.write_arrays(out / "traces.npz", traces | {"target_set": subject.targets["target_set"]})
    for index, name in enumerate(TARGET_SETS):
        of_set = {key: errors[:, subject.targets["target_set"] == index] for key, errors in traces.items()}
        figure = figures.errors_over_time(of_set, config.policy.environment.control_period)
        save_png(figure, out / f"errors_{name}.png", dpi=110)
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
    artifacts.write_json(out / "metrics.json", found)
    written = [
        *([tables.tuning_table(tuned)] if tuned else []),
        tables.effects_table(alone),
        *([tables.ablation_table(ablated)] if ablated else []),
    ]
    artifacts.write_bytes(out / "table.md", "\n".join(map(as_markdown, written)).encode())
    for table in written:
        log.info("%s\n", as_text(table))
    log.info("residual: encoder noise alone, averaged since arrival: %s", floor)
