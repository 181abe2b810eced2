"""Every inverse-kinematics method on the same targets, its commands settled in the physics: no feedback, no policy."""

import dataclasses
from collections.abc import Callable
from typing import Annotated

import numpy as np

from qjrl.config import Range
from qjrl.control.inversion import IKConfig, solve_model
from qjrl.control.targets import draw_bends, target_poses
from qjrl.robot.forward_model import PoseFunction
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import SettleResult, settle
from qjrl.solvers import FabrikConfig, SolveResult, solve_fabrik, solve_least_squares

# Offset of the run's seed: targets that neither the policy nor the held-out set has.
_SEED = 6_000_003


@dataclasses.dataclass(frozen=True)
class OpenLoopConfig:
    """Group `open_loop`."""

    num_targets: Annotated[int, Range(1, 1_000_000)] = 1000
    """Of each target set."""
    fabrik: FabrikConfig = FabrikConfig()
    """Iterations, relaxation and tolerances of FABRIK, which starts at home."""


@dataclasses.dataclass(frozen=True)
class OpenLoopRun:
    """What one controller commanded, and where the arm came to rest."""

    solved: SolveResult
    rest: SettleResult


def run_open_loop(
    robot: Robot,
    model: PoseFunction,
    simulation: SettleConfig,
    ik: IKConfig,
    config: OpenLoopConfig,
    target_set: str,
    seed: int,
    advance=None,
) -> tuple[np.ndarray, dict[str, OpenLoopRun]]:
    """Targets (n, 9) of a set, and controller -> run.

    Args:
        model: lengths -> pose, which the learned IK inverts; the others invert the closed form.
        advance: called with the number of newly settled commands.
    """
    targets = target_poses(robot, draw_bends(robot, target_set, config.num_targets, seed + _SEED, ik.targets))
    solvers: dict[str, Callable[[], SolveResult]] = {
        "fabrik": lambda: solve_fabrik(robot, targets, config=config.fabrik),
        "least_squares": lambda: solve_least_squares(
            robot, targets, np.zeros((robot.num_segments, 2)), ik.least_squares
        ),
        "learned_ik": lambda: solve_model(robot, targets, model, ik, seed + _SEED),
    }
    runs = {}
    for name, solve in solvers.items():
        solved = solve()
        rest = settle(robot, np.asarray(solved.cable_lengths), config=simulation, advance=advance)
        runs[name] = OpenLoopRun(solved, rest)
    return targets, runs
