import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from qjrl.geometry.rotations import (
    geodesic_angle,
    orthonormalise,
    rotation_vector,
    rotation_x,
    rotation_y,
    rotation_z,
    safe_norm,
)

ANGLES = st.floats(-np.pi, np.pi)
rotation_xyz = jax.jit(lambda a, b, c: rotation_x(a) @ rotation_y(b) @ rotation_z(c))
angle_between = jax.jit(geodesic_angle)
vector_of = jax.jit(rotation_vector)


@pytest.mark.parametrize(("rotation", "axis"), [(rotation_x, 0), (rotation_y, 1), (rotation_z, 2)])
def test_elementary_rotations_turn_right_handed_about_their_axis(rotation, axis):
    before, after = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
    np.testing.assert_allclose(rotation(jnp.asarray(np.pi / 2)) @ before, after, atol=1e-15)
    np.testing.assert_allclose(rotation(jnp.asarray(0.7)) @ np.eye(3)[axis], np.eye(3)[axis], atol=1e-15)


@settings(deadline=None, max_examples=50)
@given(ANGLES, ANGLES, ANGLES)
def test_products_of_rotations_are_rotations(a, b, c):
    matrix = rotation_xyz(a, b, c)
    np.testing.assert_allclose(matrix.T @ matrix, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) > 0.0


@settings(deadline=None, max_examples=50)
@given(ANGLES, ANGLES, ANGLES, st.floats(0.0, np.pi))
def test_the_geodesic_angle_is_the_angle_turned_by(a, b, c, angle):
    start = rotation_xyz(a, b, c)
    assert abs(float(angle_between(start, start @ rotation_z(jnp.asarray(angle)))) - angle) < 1e-7  # sqrt(eps) at pi


@pytest.mark.parametrize("angle", [1e-6, 1e-4, 1e-2])
def test_the_geodesic_angle_resolves_small_angles_in_float32(angle):
    turned = rotation_x(jnp.float32(angle))
    assert turned.dtype == jnp.float32
    np.testing.assert_allclose(geodesic_angle(jnp.eye(3, dtype=jnp.float32), turned), angle, rtol=1e-5)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_gradients_are_finite_where_the_angle_is_zero(dtype):
    frame = jnp.eye(3, dtype=dtype)
    gradient = jax.grad(lambda other: geodesic_angle(frame, other))(frame)
    assert gradient.dtype == dtype
    assert np.isfinite(gradient).all()
    np.testing.assert_array_equal(jax.grad(safe_norm)(jnp.zeros(3, dtype)), 0.0)


@settings(deadline=None, max_examples=50)
@given(ANGLES, ANGLES, ANGLES, st.floats(0.1, 10.0))
def test_orthonormalising_leaves_a_rotation_and_ignores_its_scale(a, b, c, scale):
    rotation = rotation_xyz(a, b, c)
    np.testing.assert_allclose(orthonormalise(scale * rotation[:, :2].T), rotation, atol=1e-12)


def test_orthonormalising_skewed_columns_keeps_the_first_direction():
    columns = jnp.array([[2.0, 0.0, 0.0], [1.0, 3.0, 0.0]])
    np.testing.assert_allclose(orthonormalise(columns), np.eye(3), atol=1e-15)


def test_orthonormalising_degenerate_columns_stays_finite():
    for columns in (jnp.zeros((2, 3)), jnp.ones((2, 3))):
        assert np.isfinite(orthonormalise(columns)).all()
        assert np.isfinite(jax.grad(lambda c: orthonormalise(c).sum())(columns)).all()


@settings(max_examples=30)
@given(st.floats(0.0, 3.0), ANGLES, st.floats(-1.0, 1.0))
def test_the_rotation_vector_is_axis_times_angle(angle, longitude, height):
    radius = np.sqrt(1.0 - height**2)
    vector = angle * np.array([radius * np.cos(longitude), radius * np.sin(longitude), height])
    np.testing.assert_allclose(vector_of(Rotation.from_rotvec(vector).as_matrix()), vector, atol=1e-7)


def test_the_rotation_vector_is_smooth_at_no_turn():
    np.testing.assert_array_equal(rotation_vector(jnp.eye(3)), np.zeros(3))
    slope = jax.jacobian(lambda angle: rotation_vector(rotation_z(angle)))(jnp.asarray(0.0))
    np.testing.assert_allclose(slope, [0.0, 0.0, 1.0], atol=1e-12)
