"""Stage `ik`: invert the forward model, settle every answer in the physics, and write the policy's target bank."""

import dataclasses
import logging
import time
from pathlib import Path

from qjrl import artifacts, progress
from qjrl.control.inversion import IKConfig, settle_answers, solve_both_sets
from qjrl.control.targets import TARGET_SETS
from qjrl.keys import seed_for
from qjrl.report.answers import outcomes_of_answers, predicted_errors
from qjrl.report.metrics import metrics_of
from qjrl.robot import robot_from_mapping
from qjrl.robot.forward_model import load_pose_function
from qjrl.simulation.settle_problem import SettleConfig

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config:
    robot: dict
    simulation: SettleConfig
    ik: IKConfig
    seed: int


def run(config: Config, inputs: dict[str, Path], out: Path) -> None:
    """Write `held_out.npz` (answers and what they settled at), `bank.npz` (targets to train on) and `metrics.json`."""
    robot = robot_from_mapping(config.robot)
    model = load_pose_function(inputs["forward_model"] / "model", robot)
    sets = len(TARGET_SETS)
    start = time.monotonic()
    with progress.track(sets * config.ik.num_held_out, "inverting held-out targets") as advance:
        answers = solve_both_sets(
            robot, model, config.ik, config.ik.num_held_out, seed_for(config.seed, "held-out targets"), advance
        )
    rate = sets * config.ik.num_held_out / (time.monotonic() - start)
    with progress.track(2 * sets * config.ik.num_held_out, "settling their answers") as advance:
        answers |= settle_answers(robot, config.simulation, answers, advance)
    artifacts.write_arrays(out / "held_out.npz", answers)
    if not (out / "bank.npz").exists():
        with progress.track(sets * config.ik.num_bank, "inverting the policy's targets") as advance:
            bank = solve_both_sets(
                robot, model, config.ik, config.ik.num_bank, seed_for(config.seed, "target bank"), advance
            )
        artifacts.write_arrays(out / "bank.npz", bank)
    metrics = {
        "targets_per_second": rate,
        "predicted": predicted_errors(answers, TARGET_SETS),
        "real": metrics_of(outcomes_of_answers(answers, TARGET_SETS)),
    }
    artifacts.write_json(out / "metrics.json", metrics)
    _report(metrics)


def _report(metrics: dict) -> None:
    for target_set, controllers in metrics["real"].items():
        log.info(
            "ik: %s targets, settled in the physics: learned %.3f mm and %.3f deg, nominal %.3f mm and %.3f deg (medians)",
            target_set,
            *(
                controllers[name][f"{key}"]
                for name in ("learned_ik", "nominal")
                for key in ("position_median_mm", "orientation_median_deg")
            ),
        )
