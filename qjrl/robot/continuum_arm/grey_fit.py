"""Fit the grey model's numbers to measured poses: least squares with the description as prior, and how sure they are."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.flatten_util import ravel_pytree
from scipy.optimize import least_squares

from qjrl.geometry.pose import pose_difference
from qjrl.robot.continuum_arm.arm import ContinuumArm
from qjrl.robot.continuum_arm.grey import GreyNumbers, grey_pose, prior_mean, prior_spread, rubbing_of
from qjrl.xla_options import jit_of_chains

ARM_OF_ROTATION = 0.25
"""Metres that a radian counts as."""
_ROUNDS = 3
_FIRST_SCATTER = 0.003
"""What the first round believes of the poses [m]; later ones measure it."""
ROWS = 256
"""Of the compiled program; fewer are filled up."""


@struct.dataclass
class FittedGrey:
    """Numbers with their covariance."""

    numbers: GreyNumbers
    covariance: Any
    """(k, k) of the numbers in a row."""
    scatter: Any
    """() what the fit leaves, a coordinate [m]; rotations count as `ARM_OF_ROTATION`."""


def fit_grey(arm: ContinuumArm, data: Mapping[str, np.ndarray]) -> FittedGrey:
    """Numbers that explain poses (n, 9) at cable lengths (n, cables) [m]; columns of a data set.

    Args:
        data: "cable_lengths", "pose" and, where they are known, "previous_cable_lengths": without, no friction is fitted.
    """
    mean, unravel = ravel_pytree(prior_mean(arm))
    mean, spread = np.asarray(mean, np.float64), np.asarray(ravel_pytree(prior_spread(arm))[0], np.float64)
    lengths, poses = (jnp.asarray(data[name], jnp.float64) for name in ("cable_lengths", "pose"))
    rubbing = rubbing_of_rows(arm, data)
    count = len(lengths)
    fill = lambda rows: jnp.resize(rows, (-(-count // ROWS) * ROWS, *rows.shape[1:]))  # noqa: E731
    columns = tuple(fill(rows) for rows in (lengths, poses, rubbing))
    at = mean
    scatter = _FIRST_SCATTER
    for _ in range(_ROUNDS):
        found = least_squares(
            lambda z, s=scatter: _residuals(arm, unravel, mean + spread * z, columns, count, s, z),
            (at - mean) / spread,
            jac=lambda z, s=scatter: _slopes(arm, unravel, mean + spread * z, columns, count, s, spread),  # pyright: ignore[reportArgumentType]
            method="lm",
            max_nfev=60,
        )
        at = mean + spread * found.x
        left = _residuals(arm, unravel, at, columns, count, 1.0, found.x)[: 6 * count]
        scatter = float(np.sqrt(np.sum(left**2) / max(1, 6 * count - len(mean) // 2)))
    slopes = _slopes(arm, unravel, at, columns, count, scatter, spread)
    covariance = np.linalg.inv(slopes.T @ slopes) * np.outer(spread, spread)
    return FittedGrey(unravel(jnp.asarray(at)), jnp.asarray(covariance), jnp.asarray(scatter))


def rubbing_of_rows(arm: ContinuumArm, data: Mapping[str, np.ndarray]) -> jax.Array:
    """(n, S, 2) of `rubbing_of`; zeros where it is not known what the cables held before."""
    lengths = jnp.asarray(data["cable_lengths"])
    if "previous_cable_lengths" not in data:
        return jnp.zeros((len(lengths), arm.num_segments, 2))
    return _rubbing(arm, lengths, jnp.asarray(data["previous_cable_lengths"]))


@jax.jit
def _rubbing(arm: ContinuumArm, lengths: jax.Array, previous: jax.Array) -> jax.Array:
    return jax.vmap(partial(rubbing_of, arm))(lengths, previous)


def _residuals(arm, unravel, row, columns, count, scatter, z) -> np.ndarray:
    left = np.asarray(_left(arm, unravel(jnp.asarray(row)), *columns))[:count]
    return np.concatenate([left.reshape(-1) / scatter, z])


def _slopes(arm, unravel, row, columns, count, scatter, spread) -> np.ndarray:
    slopes = jax.tree.leaves(_left_slopes(arm, unravel(jnp.asarray(row)), *columns))
    rows = len(columns[0])
    flat = np.concatenate([np.asarray(leaf).reshape(rows, 6, -1) for leaf in slopes], axis=2)[:count]
    return np.concatenate([flat.reshape(6 * count, -1) * spread / scatter, np.eye(len(spread))])


def _left_of_row(arm: ContinuumArm, numbers: GreyNumbers, lengths: jax.Array, pose: jax.Array, rubbing: jax.Array):
    """(6,) [m] what the model lacks of a measured pose."""
    lacking = pose_difference(grey_pose(arm, numbers, lengths, rubbing), pose)
    return -lacking * jnp.array([1.0, 1.0, 1.0, *[ARM_OF_ROTATION] * 3])


@jit_of_chains
def _left(arm: ContinuumArm, numbers: GreyNumbers, *columns: jax.Array) -> jax.Array:
    return jax.lax.map(lambda row: _left_of_row(arm, numbers, *row), columns, batch_size=ROWS)


@jit_of_chains
def _left_slopes(arm: ContinuumArm, numbers: GreyNumbers, *columns: jax.Array) -> Any:
    def slopes(row: Any) -> Any:
        return jax.jacrev(lambda one: _left_of_row(arm, one, *row))(numbers)

    return jax.lax.map(slopes, columns, batch_size=ROWS)
