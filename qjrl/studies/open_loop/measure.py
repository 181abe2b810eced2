"""Every inverse-kinematics method on the same targets, its commands settled in the physics: no feedback, no policy."""

import dataclasses
from typing import Annotated

import numpy as np

from qjrl.config import Range, configuration
from qjrl.control.first_commands import first_commands
from qjrl.control.inversion import IKConfig
from qjrl.control.targets import draw_configurations, target_poses
from qjrl.keys import seed_for
from qjrl.robot.pose_model import PoseFunction
from qjrl.robot.verbs import Robot
from qjrl.simulation.rested import require_rest
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import SettleResult, settle
from qjrl.solvers import FabrikConfig, SolveResult


@configuration
class OpenLoopConfig:
    """Group `open_loop`."""

    num_targets: Annotated[int, Range(1, 1_000_000)] = 1000
    """Of each target set; ours."""
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
    targets = target_poses(
        robot,
        draw_configurations(
            robot, target_set, config.num_targets, seed_for(seed, "targets of the open loop"), ik.targets
        ),
    )
    runs = {}
    for name, solved in first_commands(
        robot, model, ik, config.fabrik, targets, seed_for(seed, "targets of the open loop")
    ).items():
        rest = settle(robot, np.asarray(solved.cable_lengths), config=simulation, advance=advance)
        require_rest(rest.converged, f"open_loop: {name}'s answers to {target_set} targets")
        runs[name] = OpenLoopRun(solved, rest)
    return targets, runs
