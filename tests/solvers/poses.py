"""What every solver is asked and held to in its tests."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from arms import over_rows, random_bends

from qjrl.geometry.pose import orientation_error, position_error
from qjrl.robot import bends_from_cables, forward_kinematics
from qjrl.solvers import Status

POSITION_TOLERANCE, ORIENTATION_TOLERANCE = 1e-5, np.radians(0.01)


def reachable(arm, count, seed=0, share=1.0):
    """Poses (count, 9) of random bends."""
    return over_rows(forward_kinematics, arm, random_bends(arm, count, seed, share))


def unreachable(arm):
    """Poses (3, 9): beyond the arm's length; home turned upside down; below the base."""
    poses = reachable(arm, 3)
    poses = poses.copy()
    poses[0, :3] = [0.0, 0.0, 5.0]
    poses[1] = np.asarray(forward_kinematics(arm, jnp.zeros((arm.num_segments, 2))))
    poses[1, 3:] = [1.0, 0.0, 0.0, 0.0, -1.0, 0.0]
    poses[2, :3] = [0.0, 0.1, -3.0]
    return poses


def turned(poses, angle):
    """Poses that the same arm reaches with all its bends turned about the base's axis: the tip's frame turns along."""
    c, s = np.cos(angle), np.sin(angle)
    position, x, y = np.moveaxis(poses.reshape(-1, 3, 3), 1, 0)
    rows = np.stack([position, c * x - s * y, s * x + c * y], axis=1)
    return (rows @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T).reshape(-1, 9)


def turned_bends(bends, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(bends) @ np.array([[c, -s], [s, c]]).T


def assert_sound(arm, result, targets):
    """Errors are those of the answers, converged means near and within limits, and nothing is NaN."""
    for field in dataclasses.fields(result):
        assert np.isfinite(np.asarray(getattr(result, field.name), float)).all(), field.name
    poses = jnp.asarray(over_rows(forward_kinematics, arm, over_rows(bends_from_cables, arm, result.cable_lengths)))
    position = np.asarray(jax.vmap(position_error)(poses, targets))
    orientation = np.asarray(jax.vmap(orientation_error)(poses, targets))
    np.testing.assert_allclose(result.position_error, position, atol=1e-12)
    np.testing.assert_allclose(result.orientation_error, orientation, atol=1e-9)
    angle = 2.0 * np.arcsin(np.minimum(np.linalg.norm(result.bends, axis=-1), 1.0)).max(axis=-1)
    is_good = (
        (position <= POSITION_TOLERANCE)
        & (orientation <= ORIENTATION_TOLERANCE)
        & (angle <= float(arm.bend_limit) + 1e-8)
    )
    np.testing.assert_array_equal(result.converged, is_good)
    np.testing.assert_array_equal(result.converged, np.asarray(result.status) == Status.CONVERGED)
