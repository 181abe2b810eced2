"""Does a file compute what the package computes? Asked of the very bytes that will be written, before they are.

The reference is the live model in float64; the file is read back as its user reads it.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import Range, configuration
from qjrl.geometry.pose import row_errors
from qjrl.robot.kinds import kind_of, num_coordinates
from qjrl.robot.pose_model import PoseFunction, model_poses
from qjrl.robot.verbs import Robot, bends_from_cables, cable_lengths

LoadedFunction = Callable[..., Mapping[str, Any]]
Report = dict[str, dict[str, float]]
"""Set of rows -> measured numbers."""


class ParityError(RuntimeError):
    """A file computes something else than the package; nothing was written."""


@configuration
class ParityConfig:
    """What is compared and how far apart the answers may be; all values ours."""

    num_random: Annotated[int, Range(1, 1_000_000)] = 512
    """Random feasible cable lengths."""
    num_held_out: Annotated[int, Range(1, 1_000_000)] = 512
    """Rows that the fit never saw, at most."""
    position: Annotated[float, Range(above=0.0)] = 1e-5
    """Largest difference of a position, or of a predicted position error [m]."""
    orientation: Annotated[float, Range(above=0.0)] = 1e-4
    """Largest difference of an orientation, or of a predicted orientation error [rad]."""
    convergence: Annotated[float, Range(low=0.0, high=1.0)] = 0.02
    """By how much the share of converged targets may lie below that of the same solver run by the package."""


@dataclasses.dataclass(frozen=True)
class Reference:
    """Where a file is asked, and what the live model says there. All sets of rows together: each size is compiled anew."""

    robot: Robot
    live: Callable[[Any], np.ndarray]
    """The live model in float64 over a batch, compiled."""
    sets: dict[str, slice]
    """Which rows belong to which set."""
    lengths: np.ndarray
    """(n, num_cables) [m], for the forward model."""
    poses: np.ndarray
    """(n, 9) the live model's poses of them."""
    targets: np.ndarray
    """(n, 9) [m, -], for the inverse: the live model's poses of random rows, the measured ones of held-out rows."""
    precision: str
    """Of what goes into a file."""
    config: ParityConfig


def make_reference(
    robot: Robot,
    pose: PoseFunction,
    held_out: Mapping[str, np.ndarray],
    precision: str,
    config: ParityConfig,
    seed: int,
) -> Reference:
    """Random rows and held-out ones, and the live model's poses.

    Args:
        held_out: columns `cable_lengths` and `pose` of rows that the fit never saw.
    """
    numbers = np.random.default_rng(seed).random((config.num_random, num_coordinates(robot)))
    draw = jax.jit(jax.vmap(lambda row: cable_lengths(robot, kind_of(robot).from_unit_cube(robot, row))))
    measured = held_out["pose"][: config.num_held_out]
    lengths = np.concatenate([draw(jnp.asarray(numbers)), held_out["cable_lengths"][: config.num_held_out]])
    live = functools.partial(model_poses, pose)
    poses = live(lengths)
    sets = {"random": slice(0, config.num_random), "held_out": slice(config.num_random, len(lengths))}
    targets = np.concatenate([poses[sets["random"]], measured])
    return Reference(robot, live, sets, lengths, poses, targets, precision, config)


def check_forward(file: str, call: LoadedFunction, reference: Reference) -> Report:
    """Largest differences of the file's poses from the live model's, per set of rows.

    Raises:
        ParityError: a difference beyond the tolerance, or a number that is not finite.
    """
    poses, config = _host(call(reference.lengths.astype(reference.precision)))["pose"], reference.config
    position, orientation = row_errors(poses, reference.poses)
    return {
        name: {
            "rows": rows.stop - rows.start,
            "position_difference": _checked(f"{file}: {name} rows: position", position[rows], config.position, "m"),
            "orientation_difference": _checked(
                f"{file}: {name} rows: orientation", orientation[rows], config.orientation, "rad"
            ),
        }
        for name, rows in reference.sets.items()
    }


def check_inverse(file: str, call: LoadedFunction, solve: LoadedFunction, reference: Reference) -> Report:
    """Whether the file tells the truth about its answers, keeps the limits, and solves as many targets as the package.

    Redundant answers need not agree in their lengths; what they reach must.

    Args:
        solve: the same solver run by the package, over a batch.
    Raises:
        ParityError: a stated error off the live model's, a joint beyond its limit, or fewer targets solved.
    """
    targets, config = reference.targets.astype(reference.precision), reference.config
    found, expected = _host(call(targets)), _host(solve(targets))
    reached = np.asarray(reference.live(found["cable_lengths"]))
    position, orientation = row_errors(reached, reference.targets)
    position, orientation = found["position_error"] - position, found["orientation_error"] - orientation
    beyond = _beyond_limit(reference.robot, found["cable_lengths"])
    is_same = np.max(np.abs(found["cable_lengths"] - expected["cable_lengths"]), axis=1) < _SAME_LENGTH
    report = {}
    for name, rows in reference.sets.items():
        where = f"{file}: {name} targets"
        _checked(f"{where}: bend and its limit", beyond[rows], _LIMIT_ROUNDING, "-")
        report[name] = {
            "targets": rows.stop - rows.start,
            "position_error_difference": _checked(
                f"{where}: stated position error", position[rows], config.position, "m"
            ),
            "orientation_error_difference": _checked(
                f"{where}: stated orientation error", orientation[rows], config.orientation, "rad"
            ),
            "same_answer_share": float(is_same[rows].mean()),
            "converged_share": _enough(where, found["converged"][rows], expected["converged"][rows], config),
            "package_converged_share": float(expected["converged"][rows].mean()),
        }
    return report


def _checked(what: str, values: np.ndarray, tolerance: float, unit: str) -> float:
    """The largest magnitude, if it is finite and within the tolerance."""
    largest = float(np.max(np.abs(values)))
    if not largest <= tolerance:  # a NaN is not
        raise ParityError(f"{what} differ by {largest:.3g} {unit}, allowed: {tolerance:.3g}; nothing was written")
    return largest


def _enough(where: str, converged: np.ndarray, expected: np.ndarray, config: ParityConfig) -> float:
    """The share of converged targets, if it is about the package's."""
    share, package = float(converged.mean()), float(expected.mean())
    if share < package - config.convergence:
        raise ParityError(f"{where}: {share:.1%} converge, {package:.1%} in the package; nothing was written")
    return share


def _host(outputs: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Arrays on the host, numbers in float64."""
    arrays = {name: np.asarray(array) for name, array in outputs.items()}
    return {name: array if array.dtype == bool else array.astype(np.float64) for name, array in arrays.items()}


def _beyond_limit(robot: Robot, lengths: np.ndarray) -> np.ndarray:
    """(n,) by how much the largest bend of each row exceeds sin(limit/2)."""
    bends = np.asarray(_compiled_bends()(robot, lengths))
    largest = np.linalg.norm(bends, axis=-1).max(axis=-1)
    return np.maximum(largest - np.sin(float(robot.bend_limit) / 2.0), 0.0)


@functools.cache
def _compiled_bends() -> Callable[..., jax.Array]:
    return jax.jit(jax.vmap(bends_from_cables, in_axes=(None, 0)))


# Rounding of a bend at its limit in single precision, from lengths of a tenth of a metre.
_LIMIT_ROUNDING = 1e-5
_SAME_LENGTH = 1e-4
"""Cable lengths that no motor tells apart [m]."""
