"""What every inverse-kinematics solver returns, and the check of what it is asked."""

import enum

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.geometry.pose import orientation_error, position_error
from qjrl.robot.forward_model import PoseFunction
from qjrl.robot.kinds import require_robot
from qjrl.robot.plausibility import FARTHEST_TARGET, check_positions, real_numbers
from qjrl.robot.verbs import Robot, bends_from_cables, strand_tension


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


def check_initial_bends(robot: Robot, bends, count: int) -> np.ndarray:
    """Bends to start from as float64 (count, segments, 2), from one row a target or one for all.

    Raises:
        ValueError: wrong shape, non-finite values, or |a| of 1 or more.
    """
    bends, expected = np.asarray(real_numbers(bends, "initial_bends"), np.float64), (robot.num_segments, 2)
    if bends.shape not in (expected, (count, *expected)):
        raise ValueError(f"initial_bends: got shape {bends.shape}, allowed: {expected} or {(count, *expected)}")
    if not np.all(np.linalg.norm(bends, axis=-1) < 1.0):
        raise ValueError("initial_bends: got non-finite values or a length of 1 or more, allowed: sin(theta/2) below 1")
    return np.broadcast_to(bends, (count, *expected))


def describe_solution(
    robot: Robot, pose_of: PoseFunction, targets: jax.Array, lengths: jax.Array, tolerances: tuple[float, float], steps
) -> SolveResult:
    """Re-evaluate the model at the answers and evaluate them by position [m] and orientation [rad] tolerance."""
    poses = jax.vmap(pose_of)(lengths)
    position = jax.vmap(position_error)(poses, targets)
    orientation = jax.vmap(orientation_error)(poses, targets)
    bends = jax.vmap(lambda row: bends_from_cables(robot, row))(lengths)
    is_inside = jnp.max(jnp.linalg.norm(bends, axis=-1), axis=-1) <= jnp.sin(robot.bend_limit / 2.0) + 1e-9
    is_near = (position <= tolerances[0]) & (orientation <= tolerances[1])
    status = jnp.where(is_inside, jnp.where(is_near, Status.CONVERGED, Status.ITERATION_LIMIT), Status.OUTSIDE_LIMITS)
    tension = jax.vmap(lambda row: least_tension(robot, row))(lengths)
    return SolveResult(lengths, bends, position, orientation, is_near & is_inside, status, steps, tension)


def least_tension(robot: Robot, lengths: jax.Array) -> jax.Array:
    """Tension of the least loaded strand [N], see `SolveResult.least_tension`, at cable lengths (num_cables,) [m].

    Half the steps of statics leave this strand's tension within 1e-6 N, and double the speed.
    """
    return jnp.min(strand_tension(robot, lengths, _STEPS))


def count_statuses(status) -> dict[str, int]:
    """Answers by how they ended, "converged" and so on, from `SolveResult.status` (n,); what does not occur is left out."""
    counts = {one.name.lower(): int(np.sum(np.asarray(status) == one)) for one in Status}
    return {name: count for name, count in counts.items() if count}


# Of the search for where the arm rests.
_STEPS = 6
