"""How near every controller comes to targets that the arm can reach: open loop, and with measurements of the pose."""

import dataclasses
import functools
from pathlib import Path
from typing import Annotated

import numpy as np

from qjrl import artifacts
from qjrl.config import Range, configuration
from qjrl.control.first_commands import CONTROLLERS, first_commands
from qjrl.control.inversion import IKConfig
from qjrl.robot.pose_model import PoseFunction
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.solvers import FabrikConfig, SolveResult
from qjrl.studies.accuracy.feasibility import UnreachableConfig
from qjrl.studies.accuracy.feedback import Corrected, MeasurementNoise, measure_and_correct


@configuration
class AccuracyConfig:
    """Group `accuracy`; all values ours but FABRIK's tolerances."""

    num_targets: Annotated[int, Range(1, 1_000_000)] = 1000
    """Settled poses of commands from another seed."""
    distance: Annotated[float, Range(low=0.0)] = 0.005
    """... whose tip lies at least this far from the tip of every training pose [m]."""
    measurements: Annotated[int, Range(0, 100)] = 4
    """Measurements and corrections after the first command."""
    noise: MeasurementNoise = MeasurementNoise()
    """Of the measurements, in the second of two runs; the first has none."""
    fabrik: FabrikConfig = FabrikConfig()
    """Iterations, relaxation and tolerances of FABRIK."""
    unreachable: UnreachableConfig = UnreachableConfig()
    """Targets out of reach, made of the same."""


def evaluate_accuracy(
    robot: Robot,
    model: PoseFunction,
    simulation: SettleConfig,
    ik: IKConfig,
    config: AccuracyConfig,
    targets: np.ndarray,
    seed: int,
    directory: Path,
    advance=None,
) -> dict[str, dict[str, Corrected]]:
    """ "exact" and "noisy" -> controller -> errors on targets (n, 9); what is in `directory` already is not done again.

    All controllers get the same measurements, and each corrects through the model that it inverts.

    Args:
        directory: gets `commands.npz` (answers by controller) and one file for each of the runs.
        advance: called with the number of newly settled commands, 2 (measurements + 1) n for each of three controllers.
    """
    commands = artifacts.load_or_make(
        directory / "commands.npz",
        lambda: _columns(first_commands(robot, model, ik, config.fabrik, targets, seed)),
    )
    found = {}
    for kind, noise in (("exact", MeasurementNoise(0.0, 0.0)), ("noisy", config.noise)):
        found[kind] = {}
        for name in CONTROLLERS:
            run = functools.partial(
                measure_and_correct, robot, model if name == "learned_ik" else None, simulation, ik.least_squares, targets,
                commands[f"{name}/cable_lengths"], config.measurements, noise, seed, advance,
            )  # fmt: skip
            path = directory / f"{kind}-{name}.npz"
            is_done = path.exists()
            found[kind][name] = Corrected(**artifacts.load_or_make(path, lambda run=run: vars(run())))
            if is_done and advance:
                advance((config.measurements + 1) * len(targets))
    return found


def _columns(answers: dict[str, SolveResult]) -> dict[str, np.ndarray]:
    """Of a file: "fabrik/cable_lengths" and so on."""
    return {
        f"{name}/{field.name}": np.asarray(getattr(answer, field.name))
        for name, answer in answers.items()
        for field in dataclasses.fields(answer)
    }
