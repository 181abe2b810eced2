"""Inverse kinematics. Many targets at once: FABRIK and least squares on the closed form, Adam on any `lengths -> pose`.
One target at a time in a control loop: `PoseFollower`."""

from qjrl.robot.ik_result import SolveResult, Status, count_statuses
from qjrl.robot.quaternion_arm.fabrik import FabrikConfig, solve_fabrik
from qjrl.solvers.adam import AdamConfig, solve_adam
from qjrl.solvers.follow import FollowConfig, NextPose, PoseFollower
from qjrl.solvers.least_squares import LeastSquaresConfig, draw_candidates, solve_least_squares

__all__ = [
    "AdamConfig",
    "FabrikConfig",
    "FollowConfig",
    "LeastSquaresConfig",
    "NextPose",
    "PoseFollower",
    "SolveResult",
    "Status",
    "count_statuses",
    "draw_candidates",
    "solve_adam",
    "solve_fabrik",
    "solve_least_squares",
]
