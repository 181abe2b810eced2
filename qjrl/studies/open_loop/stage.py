"""Stage `open_loop`: FABRIK, least squares and the learned IK, their commands settled in the physics (Fig. 8)."""

import dataclasses
import math
from pathlib import Path

import numpy as np

from qjrl import progress
from qjrl.control.inversion import IKConfig
from qjrl.control.targets import TARGET_SETS
from qjrl.geometry.pose import row_errors
from qjrl.report import metrics as measures
from qjrl.report.answers import outcome_at_rest
from qjrl.report.error_figures import cumulative_errors
from qjrl.report.outcomes import Outcome
from qjrl.report.output import Drawn, Output
from qjrl.robot import robot_from_mapping
from qjrl.robot.forward_model import load_pose_function
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.stage_config import RobotStageConfig
from qjrl.studies.open_loop.measure import OpenLoopConfig, OpenLoopRun, run_open_loop


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    simulation: SettleConfig
    ik: IKConfig
    open_loop: OpenLoopConfig


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`, `outcomes.npz` and a cumulative curve for every target set; the table is shown."""
    del out
    robot = robot_from_mapping(config.robot)
    model = load_pose_function(inputs["forward_model"] / "model", robot)
    outcomes, columns, solved = [], {}, {}
    with progress.track(3 * len(TARGET_SETS) * config.open_loop.num_targets, "settling") as advance:
        for target_set in TARGET_SETS:
            targets, runs = run_open_loop(
                robot, model, config.simulation, config.ik, config.open_loop, target_set, config.seed, advance
            )
            for name, one in runs.items():
                errors = row_errors(one.rest.pose, targets)
                outcomes.append(outcome_at_rest(name, target_set, *errors, one.rest.strand_tension, one.rest.converged))
                columns |= _columns(f"{target_set}/{name}", one, errors)
            solved[target_set] = {name: float(np.mean(one.solved.converged)) for name, one in runs.items()}
    ratios = {name: _ratios([one for one in outcomes if one.target_set == name]) for name in TARGET_SETS}
    lines = [
        f"open loop, {name} targets: the learned IK's median is {ratio['fabrik']:.1f} times smaller than FABRIK's, "
        f"{math.log10(ratio['fabrik']):.1f} orders of magnitude"
        for name, ratio in ratios.items()
    ]
    return Output(
        {"controllers": measures.metrics_of(outcomes), "solved": solved, "ratios": ratios},
        {"outcomes": columns},
        lambda: Drawn(
            {name: cumulative_errors([one for one in outcomes if one.target_set == name]) for name in TARGET_SETS}
        ),
        shown=(measures.error_table(outcomes), *lines),
    )


def _columns(prefix: str, one: OpenLoopRun, errors: tuple[np.ndarray, np.ndarray]) -> dict[str, np.ndarray]:
    return {
        f"{prefix}/cable_lengths": np.asarray(one.solved.cable_lengths),
        f"{prefix}/status": np.asarray(one.solved.status),
        f"{prefix}/settled": one.rest.converged,
        f"{prefix}/position_error": errors[0],
        f"{prefix}/orientation_error": errors[1],
    }


def _ratios(outcomes: list[Outcome]) -> dict[str, float]:
    """Median position error of every controller over the learned IK's."""
    medians = {one.controller: float(np.median(one.position_error)) for one in outcomes}
    return {name: value / medians["learned_ik"] for name, value in medians.items()}
