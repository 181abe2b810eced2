"""Stage `ik`: invert the forward model, settle every answer in the physics, and write the policy's target bank."""

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path

from qjrl import artifacts, progress
from qjrl.control.inversion import IKConfig, settle_answers, solve_both_sets
from qjrl.control.targets import TARGET_SETS
from qjrl.keys import seed_for
from qjrl.report.answers import outcomes_of_answers, predicted_errors
from qjrl.report.metrics import metrics_of
from qjrl.report.output import Output
from qjrl.robot import robot_from_mapping
from qjrl.robot.forward_model import load_pose_function
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.stage_config import RobotStageConfig


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    simulation: SettleConfig
    ik: IKConfig


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`held_out.npz` (answers and what they settled at), `bank.npz` (targets to train on) and `metrics.json`."""
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
    return Output(metrics, {"held_out": answers}, shown=list(_lines(metrics)))


def _lines(metrics: dict) -> Iterator[str]:
    for target_set, controllers in metrics["real"].items():
        medians = [
            f"{label} {controllers[name]['position_median_mm']:.3f} mm and {controllers[name]['orientation_median_deg']:.3f} deg"
            for label, name in (("learned", "learned_ik"), ("nominal", "nominal"))
        ]
        yield f"ik: {target_set} targets, settled in the physics: {', '.join(medians)} (medians)"
