"""Stage `accuracy`: every controller on targets that the arm can reach, open loop and with measurements; and what the
learned IK says of slack strands and of targets out of reach."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from qjrl import artifacts, progress
from qjrl.control.first_commands import CONTROLLERS
from qjrl.control.inversion import IKConfig
from qjrl.report.output import Drawn, Output
from qjrl.robot import robot_from_mapping, robot_hash
from qjrl.robot.forward_model import load_pose_function
from qjrl.robot.pose_model import PoseFunction
from qjrl.robot.settled_rows import settled_rows
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.solvers import count_statuses
from qjrl.stage_config import RobotStageConfig
from qjrl.studies.accuracy import corrections
from qjrl.studies.accuracy import feasibility_numbers as feasibility
from qjrl.studies.accuracy.feasibility import KINDS, evaluate_tension, evaluate_unreachable, unreachable_targets
from qjrl.studies.accuracy.feedback import Corrected
from qjrl.studies.accuracy.figures import errors_by_measurements
from qjrl.studies.accuracy.held_out import reachable_targets
from qjrl.studies.accuracy.measure import AccuracyConfig, evaluate_accuracy


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    simulation: SettleConfig
    ik: IKConfig
    accuracy: AccuracyConfig


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`, `table.md`, `unreachable.md`, `corrections.png`; the arrays of every run are written when it ends."""
    robot, settings = robot_from_mapping(config.robot), config.accuracy
    model = load_pose_function(inputs["forward_model"] / "model", robot)
    data = artifacts.load(inputs["sample"], robot_hash(robot))
    trained = settled_rows(robot, data)["pose"]
    with progress.track(settings.num_targets, "reaching for targets") as advance:
        find = lambda: reachable_targets(  # noqa: E731
            robot, config.simulation, trained, settings.num_targets, settings.distance, config.seed, advance
        )
        targets = artifacts.load_or_make(out / "targets.npz", lambda: {"target": find()})["target"]
    count = 2 * len(CONTROLLERS) * (settings.measurements + 1) * len(targets)
    with progress.track(count, "settling, correcting") as advance:
        found = evaluate_accuracy(
            robot, model, config.simulation, config.ik, settings, targets, config.seed, out, advance
        )
    commands = artifacts.load(out / "commands.npz")
    solved = {name: commands[f"{name}/converged"] for name in CONTROLLERS}
    feasible = _feasibility(config, robot, model, targets, out)
    metrics = {kind: corrections.corrections_metrics(runs) for kind, runs in found.items()}
    about = {
        "num_targets": len(targets),
        "solved_share": {name: float(np.mean(rows)) for name, rows in solved.items()},
        "statuses": {name: count_statuses(commands[f"{name}/status"]) for name in CONTROLLERS},
        "noise": corrections.noise_floor(settings.noise.position, settings.noise.orientation),
        "ratios": {kind: corrections.ratios(runs, solved) for kind, runs in found.items()},
    }
    unreachable = feasibility.unreachable_table(feasible["unreachable"])
    labels = _labels(about["noise"])
    table = corrections.corrections_table({labels[kind]: numbers for kind, numbers in metrics.items()})
    return Output(
        metrics | about | feasible,
        draw=lambda: Drawn({"corrections": _figure(found, labels, about["noise"])}),
        tables={"unreachable": (unreachable,), "table": (table,)},
        shown=list(_lines(about["ratios"]["exact"])),
    )


def _feasibility(
    config: Config, robot: Robot, model: PoseFunction, targets: np.ndarray, out: Path
) -> dict[str, dict[str, Any]]:
    """Metrics "tension" and "unreachable", from `tension.npz` and `unreachable.npz`, which go on like the rest."""
    settings, simulation, seed = config.accuracy.unreachable, config.simulation, config.seed
    tension = artifacts.load_or_make(
        out / "tension.npz", lambda: evaluate_tension(robot, model, simulation, config.ik, targets, seed)
    )
    beyond = unreachable_targets(robot, targets, settings, seed)
    unreachable = artifacts.load_or_make(
        out / "unreachable.npz",
        lambda: evaluate_unreachable(robot, model, simulation, config.ik, settings, beyond, seed),
    )
    solver = config.ik.least_squares
    return {
        "tension": feasibility.tension_metrics(tension, solver.least_tension),
        "unreachable": feasibility.unreachable_metrics(unreachable, KINDS, solver.descent.rotation_weight),
    }


def _labels(noise: dict[str, float]) -> dict[str, str]:
    """Kind of measurements -> the words for it."""
    deviations = f"{noise['position_deviation_mm']:.2g} mm, {noise['orientation_deviation_deg']:.2g}°"
    return {"exact": "exact", "noisy": f"noise {deviations}"}


def _figure(found: dict[str, dict[str, Corrected]], labels: dict[str, str], noise: dict[str, float]) -> Any:
    """The figure of all runs."""
    floors = {"exact": None, "noisy": 1e-3 * noise["position_median_mm"]}
    panels = {
        labels[kind]: ({name: one.position_error for name, one in runs.items()}, floors[kind])
        for kind, runs in found.items()
    }
    return errors_by_measurements(panels)


def _lines(ratios: dict[str, Any]) -> Iterator[str]:
    """The lines that answer the question."""
    for number, ratio in ratios.items():
        yield (
            f"accuracy, {number.removeprefix('after_')} exact measurements: FABRIK's median is "
            f"{ratio['fabrik']['ratio']:.1f} times the learned IK's, "
            f"{ratio['fabrik']['orders_of_magnitude']:.1f} orders of magnitude"
        )
