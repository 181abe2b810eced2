"""Inverse kinematics on any `lengths -> pose`, batched over targets."""

from qjrl.solvers.adam import AdamConfig, solve_adam
from qjrl.solvers.result import SolveResult, Status

__all__ = ["AdamConfig", "SolveResult", "Status", "solve_adam"]
