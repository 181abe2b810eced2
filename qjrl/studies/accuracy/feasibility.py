"""What inverse kinematics says of answers that are not simply right: slack strands, and targets out of reach."""

import dataclasses
import math
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import Range, configuration
from qjrl.control.inversion import IKConfig, solve_model
from qjrl.geometry.pose import pose_from_frame, position_of, rotation_of, row_errors
from qjrl.geometry.rotations import rotation_y, rotation_z
from qjrl.robot import forward_kinematics
from qjrl.robot.pose_model import PoseFunction, model_poses
from qjrl.robot.verbs import Robot, home
from qjrl.simulation.rested import require_rest
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import settle
from qjrl.solvers import SolveResult
from qjrl.solvers.least_squares import RoundConfig

KINDS = ("far", "turned")
"""Of targets out of reach: positions beyond the arm's length; reachable positions with a rotation turned away."""


@configuration
class UnreachableConfig:
    """Targets out of reach, made of reachable ones."""

    num_targets: Annotated[int, Range(1, 1_000_000)] = 100
    """Of each kind, at most as many as there are reachable ones."""
    reach: tuple[float, float] = (1.05, 1.3)
    """Distance of a far target from the base over the straight arm's length; its direction and rotation are kept."""
    turn: tuple[float, float] = (math.radians(120.0), math.radians(180.0))
    """Angle by which a turned target's rotation differs from the reachable one, about a random axis [rad]."""
    thorough: RoundConfig = RoundConfig(256, 60)
    """A round more than the solver has: what it finds is taken for the best there is."""


def unreachable_targets(robot: Robot, reachable: np.ndarray, config: UnreachableConfig, seed: int) -> np.ndarray:
    """Poses (2 m, 9), first far ones, then turned ones, from the first m reachable poses (n, 9).

    No pose lies beyond the straight arm's length; of the turned ones the arm may reach some after all.
    """
    poses = jnp.asarray(reachable[: config.num_targets])
    length = jnp.linalg.norm(forward_kinematics(robot, home(robot))[:3])

    def far(pose: jax.Array, key: jax.Array) -> jax.Array:
        scale = jax.random.uniform(key, minval=config.reach[0], maxval=config.reach[1])
        return pose.at[:3].multiply(scale * length / jnp.linalg.norm(pose[:3]))

    def turned(pose: jax.Array, key: jax.Array) -> jax.Array:
        key_axis, key_angle = jax.random.split(key)
        azimuth, height = jax.random.uniform(key_axis, (2,), minval=-1.0)
        axis = rotation_z(jnp.pi * azimuth) @ rotation_y(jnp.arccos(height))  # its third column is even over the sphere
        angle = jax.random.uniform(key_angle, minval=config.turn[0], maxval=config.turn[1])
        turn = axis @ rotation_z(angle) @ axis.T
        return pose_from_frame(position_of(pose), turn @ rotation_of(pose))

    keys = jax.random.split(jax.random.key(seed), (2, len(poses)))
    return np.concatenate(
        [np.asarray(jax.vmap(make)(poses, row)) for make, row in zip((far, turned), keys, strict=True)]
    )


def evaluate_unreachable(
    robot: Robot,
    model: PoseFunction,
    simulation: SettleConfig,
    ik: IKConfig,
    config: UnreachableConfig,
    targets: np.ndarray,
    seed: int,
) -> dict[str, np.ndarray]:
    """Arrays, one row a target of `unreachable_targets`: the answer, what a thorough search finds, where the arm rests.

    `model_distance` [m] and `model_angle` [rad] lie between where the arm rests and where the model said.
    """
    solver = ik.least_squares
    thorough = dataclasses.replace(
        ik, least_squares=dataclasses.replace(solver, rounds=(*solver.rounds, config.thorough))
    )
    answer, best = (solve_model(robot, targets, model, one, seed) for one in (ik, thorough))
    rest = settle(robot, np.asarray(answer.cable_lengths), config=simulation)
    said = model_poses(model, answer.cable_lengths)
    distance, angle = row_errors(rest.pose, said)
    return {
        "target": targets,
        "kind": np.repeat(np.arange(len(KINDS)), len(targets) // len(KINDS)),
        **_columns("answer", answer),
        **_columns("best", best),
        "settled": rest.converged,
        "model_distance": distance,
        "model_angle": angle,
    }


def evaluate_tension(
    robot: Robot, model: PoseFunction, simulation: SettleConfig, ik: IKConfig, targets: np.ndarray, seed: int
) -> dict[str, np.ndarray]:
    """Arrays, one row a target: answers whatever the strands carry ("any/..."), and those that the configuration asks for
    ("wanted/..."), each with the tension of its least loaded strand in the physics [N]."""
    arrays, any_answer = {}, dataclasses.replace(ik.least_squares, least_tension=0.0)
    for name, solver in (("any", any_answer), ("wanted", ik.least_squares)):
        answer = solve_model(robot, targets, model, dataclasses.replace(ik, least_squares=solver), seed)
        rest = settle(robot, np.asarray(answer.cable_lengths), config=simulation)
        require_rest(rest.converged, f"accuracy: answers with {name} tension")
        arrays |= _columns(name, answer)
        arrays |= {
            f"{name}/settled": rest.converged,
            f"{name}/settled_least_tension": rest.strand_tension.min(axis=1),
            f"{name}/settled_position_error": row_errors(rest.pose, targets)[0],
        }
    return arrays


def _columns(name: str, answer: SolveResult) -> dict[str, np.ndarray]:
    fields = ("cable_lengths", "position_error", "orientation_error", "status", "least_tension")
    return {f"{name}/{field}": np.asarray(getattr(answer, field)) for field in fields}
