"""Every controller on the same held-out targets: same physics, same randomisation, same noise."""

from collections.abc import Mapping, Sequence

import numpy as np

from qjrl.control.bases import BASES, Base, bank_of, command_column, controller_name, environment_of
from qjrl.control.evaluation import Act, Evaluation, Evaluator, arrives_in_time
from qjrl.control.policy_training import PolicyConfig, acting
from qjrl.control.targets import TARGET_SETS
from qjrl.keys import seed_for
from qjrl.learning.ppo.policy import Policy
from qjrl.robot.verbs import Robot
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.engines import make_stepper
from qjrl.simulation.rested import require_valid
from qjrl.simulation.settle_problem import SettleConfig


def compare_controllers(
    robot: Robot,
    physics: SettleConfig | EngineConfig,
    config: PolicyConfig,
    policy: Policy,
    targets: Mapping[str, np.ndarray],
    seed: int,
    advance=None,
    bases: Sequence[Base] = BASES,
) -> dict[tuple[str, str], tuple[Evaluation, int]]:
    """(target set, controller) -> evaluation, and how many targets were left out.

    Args:
        physics: what evaluates.
        config: as the policy was trained.
        targets: columns of `ik/held_out.npz`. Left out are targets at which one of the base commands arrives too
            late, and those on which any controller's simulation diverged: all controllers keep the same rows.
        bases: those evaluated beside the policy.
    """
    controllers: list[tuple[Base, Act | None]] = [*((base, None) for base in bases), (config.base, acting(policy))]
    in_time = [arrives_in_time(robot, config.environment, targets[command_column(base)]) for base, _ in controllers]
    rows = np.flatnonzero(np.all(in_time, axis=0))
    found, stepper = {}, make_stepper(robot, len(rows), physics)
    for base, act in controllers:
        of_base = environment_of(config.environment, base)
        evaluator = Evaluator(
            robot, of_base, bank_of(targets, base, rows), stepper, seed_for(seed, "arms of the comparison")
        )
        found[controller_name(base, act is not None)] = evaluator.evaluate(act, advance)
    is_valid = np.all([one.is_valid for one in found.values()], axis=0)
    for index, target_set in enumerate(TARGET_SETS):
        in_set = is_valid[targets["target_set"][rows] == index]
        require_valid(in_set, f"compare, robustness: episodes to {target_set} targets, of all controllers")
    return {
        (target_set, name): _of_set(one, rows, is_valid, targets["target_set"] == index)
        for index, target_set in enumerate(TARGET_SETS)
        for name, one in found.items()
    }


def _of_set(
    evaluation: Evaluation, rows: np.ndarray, is_valid: np.ndarray, is_in_set: np.ndarray
) -> tuple[Evaluation, int]:
    """The valid rows of one target set, and how many of its targets are missing."""
    kept = is_valid & is_in_set[rows]
    return _rows(evaluation, kept), int(is_in_set.sum() - kept.sum())


def _rows(evaluation: Evaluation, rows: np.ndarray) -> Evaluation:
    return Evaluation(
        evaluation.position_error[rows],
        evaluation.orientation_error[rows],
        evaluation.strand_tension[rows],
        evaluation.position_trace[:, rows],
        evaluation.is_valid[rows],
    )
