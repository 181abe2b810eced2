import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qjrl.geometry.pose import orientation_error, pose_from_frame, position_error, position_of, rotation_of
from qjrl.geometry.rotations import rotation_x, rotation_y, rotation_z

POSITION = jnp.array([0.1, -0.2, 0.3])
ROTATION = rotation_x(jnp.asarray(0.4)) @ rotation_y(jnp.asarray(-1.1)) @ rotation_z(jnp.asarray(2.0))
POSE = pose_from_frame(POSITION, ROTATION)


def test_a_pose_holds_the_position_and_two_columns():
    np.testing.assert_array_equal(POSE, np.concatenate([POSITION, ROTATION[:, 0], ROTATION[:, 1]]))
    np.testing.assert_array_equal(position_of(POSE), POSITION)
    np.testing.assert_allclose(rotation_of(POSE), ROTATION, atol=1e-15)


def test_errors_are_the_distance_and_the_angle_turned_by():
    moved = pose_from_frame(POSITION + jnp.array([0.003, 0.0, -0.004]), ROTATION @ rotation_y(jnp.asarray(0.25)))
    assert float(position_error(POSE, moved)) == pytest.approx(0.005, abs=1e-15)
    assert float(orientation_error(POSE, moved)) == pytest.approx(0.25, abs=1e-14)
    assert float(position_error(POSE, POSE)) == 0.0
    assert float(orientation_error(POSE, POSE)) < 1e-15


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("error", [position_error, orientation_error])
def test_gradients_of_the_errors_are_finite_at_the_target(error, dtype):
    pose = POSE.astype(dtype)
    gradient = jax.grad(error)(pose, pose)
    assert gradient.dtype == dtype
    assert np.isfinite(gradient).all()


def test_errors_batch_over_poses():
    poses = jnp.stack([POSE, POSE.at[0].add(0.01)])
    errors = jax.vmap(position_error, in_axes=(0, None))(poses, POSE)
    np.testing.assert_allclose(errors, [0.0, 0.01], atol=1e-15)
