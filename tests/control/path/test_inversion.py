"""On the two-segment arm, whose four cables have one freedom more than a position."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, over_rows

from qjrl.config import ConfigError
from qjrl.control.path.chains import chained
from qjrl.control.path.errors import counted_errors, pose_residual
from qjrl.control.path.inversion import PathInversionConfig, invert_path
from qjrl.control.path.paths import CircleConfig, ShapeConfig, make_path
from qjrl.geometry.pose import pose_from_frame
from qjrl.geometry.rotations import rotation_x
from qjrl.robot import bends_from_cables, forward_kinematics
from qjrl.robot.forward_model import pose_function
from qjrl.robot.pose_model import model_poses

ARM = arm_named("qj_22")
CONFIG = PathInversionConfig(num_starts=4)
NOMINAL = pose_function(ARM, None)


def bent_model(lengths):
    """A model some millimetres off the closed form, as a learned one is."""
    return NOMINAL(lengths * 1.03 + 2e-4 * jnp.sin(200.0 * lengths[::-1]))


def circle(radius=0.03, height=0.225):
    return make_path("circle", ShapeConfig("free", circle=CircleConfig((0.0, 0.0, height), radius), spacing=0.006))


@functools.cache
def inverted():
    return circle(), invert_path(ARM, bent_model, circle(), CONFIG)


def test_every_waypoint_is_met_on_the_model_and_the_places_between_too() -> None:
    path, cables = inverted()
    assert cables.position_error.max() < 1e-6
    fine = np.linspace(0.0, path.length, 4 * len(path.distance) + 1)
    poses = model_poses(bent_model, cables.lengths(fine))
    assert np.linalg.norm(poses[:, :3] - path.at(fine)[:, :3], axis=1).max() < 1e-5


def test_a_closed_path_ends_as_it_began() -> None:
    path, cables = inverted()
    ends = np.array([0.0, path.length])
    assert np.abs(np.diff(cables.lengths(ends), axis=0)).max() < 1e-8
    slopes = cables.lengths(ends, 1)
    assert np.abs(slopes[1] - slopes[0]).max() < 0.02 * np.abs(cables.lengths(path.distance, 1)).max()


def test_what_freedom_is_left_makes_the_cables_smooth() -> None:
    """No waypoint's self-motion makes the path smoother: the gradient of the roughness has no part along it."""
    path, cables = inverted()
    lengths, spacing = cables.lengths(path.distance), path.distance[1]
    matrix = roughness(len(lengths), spacing)
    gradient = matrix @ lengths
    gradient[0] += gradient[-1]  # both ends move as one
    step = 1e-6 * np.eye(4)
    moved = [(model_poses(NOMINAL, lengths + move) - model_poses(NOMINAL, lengths - move))[:, :3] for move in step]
    free = np.stack([np.linalg.svd(jacobian)[2][-1] for jacobian in np.stack(moved, axis=2)])
    along = np.abs(np.sum(gradient * free, axis=1))[:-1]
    assert along.max() < 0.02 * np.abs(gradient).max()
    start = chained(ARM, path, CONFIG.num_starts, 0)
    assert np.sum(lengths * (matrix @ lengths)) < np.sum(start * (matrix @ start))


def roughness(count, spacing):
    """Of the module's docstring, from dense differences; over the seam of a closed path as everywhere."""
    first, second = np.diff(np.eye(count), axis=0) / spacing, np.diff(np.eye(count), 2, axis=0) / spacing**2
    seam = (np.eye(count)[1] - np.eye(count)[0] - np.eye(count)[-1] + np.eye(count)[-2]) / spacing**2
    second = np.concatenate([second, seam[None]])
    bent = CONFIG.curvature * 0.05**4 * second.T @ second
    return spacing * (CONFIG.posture * np.eye(count) + CONFIG.travel * 0.05**2 * first.T @ first + bent)


def test_the_bends_stay_within_their_limits() -> None:
    path, cables = inverted()
    bends = over_rows(bends_from_cables, ARM, cables.lengths(path.distance))
    assert np.linalg.norm(bends, axis=2).max() < np.sin(float(ARM.bend_limit) / 2.0)


def test_waypoints_out_of_reach_are_named_in_one_line() -> None:
    half_in = circle()
    half_in.pose[:, 0] += 0.06  # only a part of it lies too far out
    with pytest.raises(
        ConfigError, match=r"track.path: \d+ of \d+ waypoints cannot be reached, the first is number"
    ) as caught:
        invert_path(ARM, bent_model, half_in, CONFIG)
    assert "\n" not in str(caught.value) and "missed by" in str(caught.value)


def test_residuals_vanish_at_the_target_alone_and_errors_count_what_they_should() -> None:
    pose = forward_kinematics(ARM, jnp.array([[0.2, 0.1], [-0.1, 0.3]]))
    rotation = jnp.stack([pose[3:6], pose[6:9], jnp.cross(pose[3:6], pose[6:9])], axis=1)
    rolled = pose_from_frame(pose[:3], rotation @ jnp.diag(jnp.array([-1.0, -1.0, 1.0])))
    flipped = pose_from_frame(pose[:3], rotation @ rotation_x(jnp.asarray(np.pi)))
    for constraint, is_same in {"pose": (False, False), "pointing": (True, False), "position": (True, True)}.items():
        assert evaluated(constraint, pose, pose)[1] < 1e-12
        for other, same in zip((rolled, flipped), is_same, strict=True):
            error, residual = evaluated(constraint, other, pose)
            assert (residual < 1e-12) == same and error == pytest.approx(0.0 if same else np.pi, abs=1e-6)


@functools.partial(jax.jit, static_argnums=0)
def evaluated(constraint, pose, target):
    """Orientation error [rad] and largest residual."""
    return counted_errors(constraint, pose, target)[1], jnp.abs(pose_residual(constraint, pose, target)).max()
