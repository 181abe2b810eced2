"""Stage `accuracy`: every controller on targets that the arm can reach, open loop and with measurements; and what the
learned IK says of slack strands and of targets out of reach."""

import dataclasses
import logging
from pathlib import Path
from typing import Any

import numpy as np

from qjrl import artifacts, progress
from qjrl.analysis.canvas import save_png
from qjrl.analysis.controllers import corrections, feasibility
from qjrl.analysis.controllers.feedback_figures import errors_by_measurements
from qjrl.analysis.tables import as_markdown, as_text
from qjrl.control.held_out import reachable_targets
from qjrl.control.inversion import IKConfig
from qjrl.control.studies.accuracy import AccuracyConfig, evaluate_accuracy
from qjrl.control.studies.feasibility import KINDS, evaluate_tension, evaluate_unreachable, unreachable_targets
from qjrl.control.studies.feedback import Corrected
from qjrl.control.studies.open_loop import CONTROLLERS
from qjrl.robot import robot_from_mapping, robot_hash
from qjrl.robot.forward_model import PoseFunction, load_pose_function
from qjrl.robot.settled_rows import settled_rows
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.solvers import count_statuses

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config:
    robot: dict
    simulation: SettleConfig
    ik: IKConfig
    accuracy: AccuracyConfig
    seed: int


def run(config: Config, inputs: dict[str, Path], out: Path) -> None:
    """Write `metrics.json`, `table.md`, `unreachable.md`, `corrections.png`, and every run's arrays, from which it goes on."""
    robot, settings = robot_from_mapping(config.robot), config.accuracy
    model = load_pose_function(inputs["forward_model"] / "model", robot)
    data = artifacts.load(inputs["sample"], robot_hash(robot))
    trained = settled_rows(data)["pose"]
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
    artifacts.write_json(out / "metrics.json", metrics | about | feasible)
    _show(found, metrics, about, out)


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
    found = {
        "tension": feasibility.tension_metrics(tension, solver.least_tension),
        "unreachable": feasibility.unreachable_metrics(unreachable, KINDS, solver.descent.rotation_weight),
    }
    table = feasibility.unreachable_table(found["unreachable"])
    artifacts.write_bytes(out / "unreachable.md", as_markdown(table).encode())
    log.info("%s", as_text(table))
    return found


def _show(found: dict[str, dict[str, Corrected]], metrics: dict, about: dict[str, Any], out: Path) -> None:
    """The table and the figure of all runs, and the lines that answer the question."""
    noise = about["noise"]
    labels = {
        "exact": "exact",
        "noisy": f"noise {noise['position_deviation_mm']:.2g} mm, {noise['orientation_deviation_deg']:.2g}°",
    }
    table = corrections.corrections_table({labels[kind]: numbers for kind, numbers in metrics.items()})
    artifacts.write_bytes(out / "table.md", as_markdown(table).encode())
    floors = {"exact": None, "noisy": 1e-3 * noise["position_median_mm"]}
    panels = {
        labels[kind]: ({name: one.position_error for name, one in runs.items()}, floors[kind])
        for kind, runs in found.items()
    }
    save_png(errors_by_measurements(panels), out / "corrections.png", dpi=110)
    log.info("%s", as_text(table))
    for number, ratio in about["ratios"]["exact"].items():
        log.info(
            "accuracy, %s exact measurements: FABRIK's median is %.1f times the learned IK's, %.1f orders of magnitude",
            number.removeprefix("after_"),
            ratio["fabrik"]["ratio"],
            ratio["fabrik"]["orders_of_magnitude"],
        )
