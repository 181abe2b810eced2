"""How near every controller comes to targets that the arm can reach: open loop, and with measurements of the pose."""

import dataclasses
from typing import Annotated

import numpy as np

from qjrl.config import Range
from qjrl.control.feedback import Corrected, MeasurementNoise, measure_and_correct
from qjrl.control.inversion import IKConfig
from qjrl.control.open_loop import first_commands
from qjrl.robot.forward_model import PoseFunction
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.solvers import FabrikConfig, SolveResult


@dataclasses.dataclass(frozen=True)
class AccuracyConfig:
    """Group `accuracy`."""

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


@dataclasses.dataclass(frozen=True)
class ControllerAccuracy:
    """One controller on all targets."""

    solved: SolveResult
    exact: Corrected
    """Corrected from exact measurements; without any, this is open loop."""
    noisy: Corrected


def judge_accuracy(
    robot: Robot,
    model: PoseFunction,
    simulation: SettleConfig,
    ik: IKConfig,
    config: AccuracyConfig,
    targets: np.ndarray,
    seed: int,
    advance=None,
) -> dict[str, ControllerAccuracy]:
    """Controller -> errors on targets (n, 9). All get the same measurements; each corrects through the model it inverts.

    Args:
        advance: called with the number of newly settled commands, 2 (measurements + 1) n for each of three controllers.
    """
    found = {}
    for name, solved in first_commands(robot, model, ik, config.fabrik, targets, seed).items():
        inverted = model if name == "learned_ik" else None
        runs = [
            measure_and_correct(
                robot, inverted, simulation, ik.least_squares, targets, np.asarray(solved.cable_lengths),
                config.measurements, noise, seed, advance,
            )
            for noise in (MeasurementNoise(0.0, 0.0), config.noise)
        ]  # fmt: skip
        found[name] = ControllerAccuracy(solved, *runs)
    return found
