"""The first command of every inverse-kinematics method for the same targets."""

import numpy as np

from qjrl.control.inversion import IKConfig, solve_model, solve_nominal
from qjrl.robot.pose_model import PoseFunction
from qjrl.robot.verbs import Robot
from qjrl.solvers import FabrikConfig, SolveResult, solve_fabrik

CONTROLLERS = ("fabrik", "least_squares", "learned_ik")
"""What `first_commands` asks, in the order of tables."""


def first_commands(
    robot: Robot, model: PoseFunction, ik: IKConfig, fabrik: FabrikConfig, targets: np.ndarray, seed: int
) -> dict[str, SolveResult]:
    """Controller -> answers for targets (n, 9). FABRIK and least squares invert the closed form, from home."""
    nominal = solve_nominal(robot, targets, ik.least_squares, seed)
    return {
        "fabrik": solve_fabrik(robot, targets, None, fabrik),
        "least_squares": nominal,
        "learned_ik": solve_model(robot, targets, model, ik, seed, nominal=nominal),
    }
