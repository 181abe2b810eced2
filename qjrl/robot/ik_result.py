"""What every inverse-kinematics solver returns, and the check of what it is asked."""

import enum
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.geometry.pose import orientation_error, position_error
from qjrl.robot.kinds import configuration_shape, kind_of, require_robot
from qjrl.robot.plausibility import FARTHEST_TARGET, check_positions, real_numbers
from qjrl.robot.pose_model import PoseFunction
from qjrl.robot.verbs import Robot, configuration_from_cables, is_within_limits, strand_tension


class Status(enum.IntEnum):
    """How a solve ended, per target."""

    CONVERGED = 0
    STALLED = 1
    """No further progress above the tolerance."""
    ITERATION_LIMIT = 2
    OUTSIDE_LIMITS = 3
    """The answer needs a joint beyond its limit."""
    NEAREST = 4
    """Out of reach as far as all starts can tell: the answer is the nearest feasible pose found, where no small motion
    within the limits lowers the weighted squared error of the pose."""


@struct.dataclass
class SolveResult:
    """One row a target. The errors are recomputed from `cable_lengths` by the model that was asked."""

    cable_lengths: jax.Array
    """(n, num_cables) [m] relative to home, + pays out."""
    bends: jax.Array
    """(n, num_segments, 2) nominal bends of these lengths."""
    position_error: jax.Array
    """(n,) [m], predicted."""
    orientation_error: jax.Array
    """(n,) [rad], predicted."""
    converged: jax.Array
    """(n,) both errors within tolerance and every joint within its limit, whether a strand is slack or not."""
    status: jax.Array
    """(n,) a `Status`."""
    steps: jax.Array
    """(n,) iterations spent."""
    least_tension: jax.Array
    """(n,) tension of the least loaded strand where the arm as described rests with these lengths [N], predicted by statics;
    0: a strand is slack, and the pose hangs on the others."""


def check_targets(robot: Robot, targets) -> np.ndarray:
    """Targets as float64 (n, 9).

    Raises:
        ValueError: wrong shape, non-finite values, columns that are not those of a rotation, or a position so far away that
            there is no sense in the nearest answer.
    """
    require_robot(robot)
    targets = np.asarray(real_numbers(targets, "targets"), np.float64)
    if targets.ndim != 2 or targets.shape[1] != 9 or len(targets) == 0:
        raise ValueError(
            f"targets: got shape {targets.shape}, allowed: (n, 9) with n at least 1, position [m] and two columns of a rotation"
        )
    if not np.all(np.isfinite(targets)):
        raise ValueError(f"targets: got non-finite values in row {int(np.argmax(~np.isfinite(targets).all(axis=1)))}")
    columns = targets[:, 3:].reshape(-1, 2, 3)
    gram = np.einsum("nic,njc->nij", columns, columns)
    is_off = np.abs(gram - np.eye(2)).max(axis=(1, 2)) > 1e-3
    if is_off.any():
        raise ValueError(
            f"targets: row {int(np.argmax(is_off))} is no rotation: its two columns must be orthonormal to 1e-3"
        )
    check_positions(robot, targets[:, :3], "targets", FARTHEST_TARGET)
    return targets


def check_initial_configurations(robot: Robot, configurations: Any, count: int) -> np.ndarray:
    """Configurations to start from as float64 (count, ...), from one a target or one for all.

    Raises:
        ValueError: wrong shape, or what no robot of the kind can have, such as bends of 180 degrees.
    """
    where, expected = "initial_bends", configuration_shape(robot)
    found = np.asarray(real_numbers(configurations, where), np.float64)
    if found.shape not in (expected, (count, *expected)):
        raise ValueError(f"{where}: got shape {found.shape}, allowed: {expected} or {(count, *expected)}")
    if not np.all(np.isfinite(found)):
        raise ValueError(f"{where}: got non-finite values, allowed: finite numbers")
    if (check := kind_of(robot).check) is not None:
        check(robot, found.reshape(-1, *expected), where)
    return np.broadcast_to(found, (count, *expected))


def describe_solution(
    robot: Robot, pose_of: PoseFunction, targets: jax.Array, lengths: jax.Array, tolerances: tuple[float, float], steps
) -> SolveResult:
    """Re-evaluate the model at the answers and evaluate them by position [m] and orientation [rad] tolerance."""
    poses = jax.vmap(pose_of)(lengths)
    position = jax.vmap(position_error)(poses, targets)
    orientation = jax.vmap(orientation_error)(poses, targets)
    configurations = jax.vmap(lambda row: configuration_from_cables(robot, row))(lengths)
    is_inside = jax.vmap(lambda one: is_within_limits(robot, one))(configurations)
    is_near = (position <= tolerances[0]) & (orientation <= tolerances[1])
    status = jnp.where(is_inside, jnp.where(is_near, Status.CONVERGED, Status.ITERATION_LIMIT), Status.OUTSIDE_LIMITS)
    tension = jax.vmap(lambda row: least_tension(robot, row))(lengths)
    return SolveResult(lengths, configurations, position, orientation, is_near & is_inside, status, steps, tension)


def least_tension(robot: Robot, lengths: jax.Array) -> jax.Array:
    """Tension of the least loaded strand [N], see `SolveResult.least_tension`, at cable lengths (num_cables,) [m].

    Half the steps of statics leave this strand's tension within 1e-6 N, and double the speed. A kind of robot without
    statics says nothing of it: not a number.
    """
    if kind_of(robot).strand_tension is None:
        return jnp.full((), jnp.nan, lengths.dtype)
    return jnp.min(strand_tension(robot, lengths, _STEPS))


def count_statuses(status) -> dict[str, int]:
    """Answers by how they ended, "converged" and so on, from `SolveResult.status` (n,); what does not occur is left out."""
    counts = {one.name.lower(): int(np.sum(np.asarray(status) == one)) for one in Status}
    return {name: count for name, count in counts.items() if count}


# Of the search for where the arm rests.
_STEPS = 6
