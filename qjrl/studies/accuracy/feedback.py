"""Measure and correct: hold a command, let the arm rest, measure its pose, and ask the model for what is missing."""

import dataclasses
import functools
from typing import Annotated

import jax
import numpy as np

from qjrl.config import Range, configuration
from qjrl.geometry.pose import pose_from_frame, position_of, rotation_of, row_errors
from qjrl.geometry.rotations import rotation_x, rotation_y, rotation_z
from qjrl.robot.pose_model import PoseFunction, as_model, or_closed_form
from qjrl.robot.verbs import Robot, bends_from_cables
from qjrl.simulation.rested import require_rest
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import settle
from qjrl.solvers import LeastSquaresConfig, solve_least_squares
from qjrl.solvers.least_squares import RoundConfig

# A correction starts next to its answer: one descent, and what it does not reach stays for the next measurement.
_ONE_DESCENT = (RoundConfig(1, 20),)


@configuration
class MeasurementNoise:
    """Of a pose measurement, normal, independent in every axis; ours."""

    position: Annotated[float, Range(low=0.0)] = 1e-4
    """Standard deviation [m]."""
    orientation: Annotated[float, Range(low=0.0)] = 0.0003490658503988659
    """Standard deviation [rad]: 0.02 degrees."""


@dataclasses.dataclass(frozen=True)
class Corrected:
    """Errors after every number of measurements, 0 first."""

    position_error: np.ndarray
    """(measurements + 1, n) [m]; NaN where the arm did not settle."""
    orientation_error: np.ndarray
    """(measurements + 1, n) [rad]."""
    cable_lengths: np.ndarray
    """(n, cables) the last commands [m]."""


def measure_and_correct(
    robot: Robot,
    model: PoseFunction | None,
    simulation: SettleConfig,
    solver: LeastSquaresConfig,
    targets: np.ndarray,
    lengths: np.ndarray,
    measurements: int,
    noise: MeasurementNoise,
    seed: int,
    advance=None,
) -> Corrected:
    """Settle, measure, correct, as often as said, whoever gave the first command.

    Args:
        model: through which corrections are found; None: the nominal closed form.
        targets: (n, 9).
        lengths: (n, cables) first commands [m].
        measurements: corrections after the first command.
    """
    one_descent = dataclasses.replace(solver, rounds=_ONE_DESCENT, nearest_iterations=0, least_tension=0.0)
    errors = []
    for number in range(measurements + 1):
        rest = settle(robot, lengths, config=simulation, advance=advance)
        require_rest(rest.converged, f"accuracy: commands after {number} measurements")
        errors.append([np.where(rest.converged, error, np.nan) for error in row_errors(rest.pose, targets)])
        if number == measurements:
            break
        key = jax.random.fold_in(jax.random.key(seed), number)
        wanted, bends = _wanted(as_model(model), noise, robot, key, lengths, rest.pose, targets)
        answer = solve_least_squares(robot, wanted, bends, one_descent, model=model)
        lengths = np.where(rest.converged[:, None], np.asarray(answer.cable_lengths), lengths)
    stacked = np.array(errors)
    return Corrected(stacked[:, 0], stacked[:, 1], lengths)


def missing_pose(model_pose: jax.Array, measured: jax.Array, target: jax.Array) -> jax.Array:
    """The pose (9,) that the model must be asked for: its own, moved as the measured pose must move to the target."""
    turn = rotation_of(target) @ rotation_of(measured).T
    position = position_of(model_pose) + position_of(target) - position_of(measured)
    return pose_from_frame(position, turn @ rotation_of(model_pose))


def measured_pose(pose: jax.Array, noise: MeasurementNoise, key: jax.Array) -> jax.Array:
    """A pose (9,) as a noisy instrument sees it."""
    key_position, key_orientation = jax.random.split(key)
    shift = noise.position * jax.random.normal(key_position, (3,))
    x, y, z = noise.orientation * jax.random.normal(key_orientation, (3,))
    turn = rotation_z(z) @ rotation_y(y) @ rotation_x(x)
    return pose_from_frame(position_of(pose) + shift, turn @ rotation_of(pose))


@functools.partial(jax.jit, static_argnums=1)
def _wanted(model: PoseFunction | None, noise: MeasurementNoise, robot: Robot, key, lengths, poses, targets):
    """What to ask the model for, row by row, and the nominal bends to start from."""
    pose_of = or_closed_form(robot, model)

    def wanted(key, lengths, pose, target):
        return missing_pose(pose_of(lengths), measured_pose(pose, noise, key), target)

    rows = jax.vmap(wanted)(jax.random.split(key, len(targets)), lengths, poses, targets)
    return rows, jax.vmap(lambda row: bends_from_cables(robot, row))(lengths)
