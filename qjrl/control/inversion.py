"""Invert a forward model for sets of targets, and settle every answer: the predicted error beside the real one."""

from typing import Annotated, Literal

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import Range, configuration
from qjrl.control.targets import TARGET_SETS, TargetConfig, draw_configurations, target_poses
from qjrl.geometry.pose import row_errors
from qjrl.robot import cable_lengths
from qjrl.robot.kinds import kind_of
from qjrl.robot.pose_model import PoseFunction
from qjrl.robot.verbs import Robot, home
from qjrl.simulation.rested import require_rest
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import settle
from qjrl.solvers import AdamConfig, LeastSquaresConfig, SolveResult, draw_candidates, solve_adam, solve_least_squares


@configuration
class IKConfig:
    """Group `ik`."""

    method: Literal["least_squares", "adam"] = "least_squares"
    """"adam": paper 000, section 4; "least_squares": ours, as accurate and hundreds of times quicker."""
    least_squares: LeastSquaresConfig = LeastSquaresConfig()
    """Rounds of starts, weights and tolerances."""
    adam: AdamConfig = AdamConfig()
    """Steps, restarts, weights and tolerances."""
    num_held_out: Annotated[int, Range(1, 1_000_000)] = 128
    """Targets of each set whose answers are settled in the physics."""
    num_bank: Annotated[int, Range(1, 1_000_000)] = 384
    """Targets of each set that the policy trains on."""
    targets: TargetConfig = TargetConfig()
    """Laws of the target sets."""


def solve_target_set(
    robot: Robot, model: PoseFunction, config: IKConfig, target_set: str, count: int, seed: int, advance=None
) -> dict[str, np.ndarray]:
    """Targets of a set with both base commands: arrays of a target bank, one row a target.

    `nominal_lengths` are the cables of the configuration that defines the target: the closed form's own answer, exact for it.
    """
    configurations = draw_configurations(robot, target_set, count, seed, config.targets)
    poses = target_poses(robot, configurations)
    answer = solve_model(robot, poses, model, config, seed, advance)
    return {
        "target_set": np.full(count, TARGET_SETS.index(target_set)),
        "target": poses,
        kind_of(robot).configuration_name: configurations,
        "nominal_lengths": np.asarray(jax.vmap(lambda row: cable_lengths(robot, row))(jnp.asarray(configurations))),
        "learned_lengths": np.asarray(answer.cable_lengths),
        "predicted_position_error": np.asarray(answer.position_error),
        "predicted_orientation_error": np.asarray(answer.orientation_error),
        "converged": np.asarray(answer.converged),
        "status": np.asarray(answer.status),
        "least_tension": np.asarray(answer.least_tension),
    }


def solve_model(
    robot: Robot,
    targets: np.ndarray,
    model: PoseFunction,
    config: IKConfig,
    seed: int,
    advance=None,
    nominal: SolveResult | None = None,
) -> SolveResult:
    """Cable lengths for targets (n, 9) by the method of the configuration.

    Least squares goes from the closed form's answer to the model's.

    Args:
        nominal: what `solve_nominal` says, where it is known already.
    """
    if config.method == "adam":
        return solve_adam(robot, targets, model, config.adam, seed, advance)
    solver = config.least_squares
    nominal = nominal or solve_nominal(robot, targets, solver, seed)
    candidates = draw_candidates(robot, solver, seed)
    answer = solve_least_squares(robot, targets, nominal.bends, solver, candidates, model)
    if advance:
        advance(len(targets))
    return answer


def solve_nominal(robot: Robot, targets: np.ndarray, solver: LeastSquaresConfig, seed: int) -> SolveResult:
    """Least squares on the closed form from home, where a target has an answer that leaves the arm as straight as it can be."""
    start = np.asarray(home(robot))
    return solve_least_squares(robot, targets, start, solver, draw_candidates(robot, solver, seed))


def settle_answers(
    robot: Robot, simulation: SettleConfig, bank: dict[str, np.ndarray], advance=None
) -> dict[str, np.ndarray]:
    """What the physics makes of both commands of every row: real errors, tension, slack. Keys "nominal_…", "learned_…".

    Raises:
        ConfigError: none of a set's answers comes to rest.
    """
    measured = {}
    for controller in ("nominal", "learned"):
        result = settle(robot, bank[f"{controller}_lengths"], config=simulation, advance=advance)
        for index, name in enumerate(TARGET_SETS):
            require_rest(result.converged[bank["target_set"] == index], f"ik: {controller} answers to {name} targets")
        position, orientation = row_errors(result.pose, bank["target"])
        measured |= {
            f"{controller}_pose": result.pose,
            f"{controller}_position_error": position,
            f"{controller}_orientation_error": orientation,
            f"{controller}_strand_tension": result.strand_tension,
            f"{controller}_joint_positions": result.joint_positions,
            f"{controller}_settled": result.converged,
        }
    return measured


def solve_both_sets(
    robot: Robot, model: PoseFunction, config: IKConfig, count: int, seed: int, advance=None
) -> dict[str, np.ndarray]:
    """`solve_target_set` for every set, one below the other."""
    banks = [solve_target_set(robot, model, config, name, count, seed, advance) for name in TARGET_SETS]
    return {name: np.concatenate([bank[name] for bank in banks]) for name in banks[0]}
