import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, logm

from qjrl.geometry import se3

exp, log = jax.jit(se3.exp), jax.jit(se3.log)
exp_rotation, log_rotation = jax.jit(se3.exp_rotation), jax.jit(se3.log_rotation)
slopes = jax.jit(lambda twist: (jax.jacfwd(se3.exp)(twist), jax.jacfwd(se3.log)(se3.exp(twist))))
there_and_back = jax.jit(lambda frame: (frame @ se3.inverse(frame), se3.frame_of(se3.pose_of(frame))))
AXES = np.random.default_rng(0).normal(size=(6, 3))
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
ANGLES = [0.0, 1e-12, 1e-8, 1e-5, 1e-4, 1e-3, 0.1, 0.4999, 0.5, 0.5001, 1.0, 2.0, 3.0, 3.14, np.pi - 1e-6, np.pi - 1e-9]


def matrix_of(twist):
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = np.cross(np.eye(3), np.asarray(twist[3:]))
    matrix[:3, 3] = twist[:3]
    return matrix


def twists(angle, length=0.4):
    shifts = np.random.default_rng(1).normal(size=AXES.shape) * length
    return np.concatenate([shifts, angle * AXES], axis=1)


@pytest.mark.parametrize("angle", [*ANGLES, np.pi, 5.0])
def test_the_exponential_is_that_of_the_matrix(angle):
    for twist in twists(angle):
        np.testing.assert_allclose(exp(twist), expm(matrix_of(twist)), atol=5e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_the_logarithm_undoes_the_exponential_up_to_half_a_turn(angle):
    for twist in twists(angle):
        np.testing.assert_allclose(log(exp(twist)), twist, atol=1e-14 if angle < 3.1 else 1e-13)


@pytest.mark.parametrize("angle", [1e-5, 1e-3, 0.3, 1.5, 3.0])
def test_the_logarithm_is_that_of_the_matrix(angle):
    for twist in twists(angle):
        frame = expm(matrix_of(twist))
        np.testing.assert_allclose(matrix_of(log(frame)), np.real(logm(frame)), atol=1e-10)  # logm is no better


@pytest.mark.parametrize("axis", [*AXES, *np.eye(3), *-np.eye(3), [0.6, 0.8, 0.0]], ids=str)
def test_at_half_a_turn_the_axis_is_found_with_either_sign(axis):
    rotation = 2.0 * np.outer(axis, axis) - np.eye(3)
    vector = np.asarray(log_rotation(rotation))
    np.testing.assert_allclose(np.linalg.norm(vector), np.pi, atol=1e-14)
    np.testing.assert_allclose(exp_rotation(vector), rotation, atol=1e-14)


@settings(max_examples=100)
@given(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6))
def test_any_frame_comes_back_from_its_twist_and_times_its_inverse_is_none(numbers):
    frame = exp(jnp.array(numbers))
    np.testing.assert_allclose(exp(log(frame)), frame, atol=1e-12)
    none, again = there_and_back(frame)
    np.testing.assert_allclose(none, np.eye(4), atol=1e-14)
    np.testing.assert_allclose(again, frame, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.5, 2.0, 3.1])
def test_the_slopes_are_finite_and_those_of_the_two_undo_each_other(angle):
    for twist in twists(angle)[:2]:
        there, back = slopes(twist)
        np.testing.assert_allclose(np.einsum("iab,abj->ij", back, there), np.eye(6), atol=1e-10)


def test_small_turns_keep_their_digits_in_float32():
    twist = jnp.array([0.1, -0.2, 0.3, 1e-4, 2e-4, -3e-4], jnp.float32)
    frame = exp(twist)
    assert frame.dtype == jnp.float32 and log(frame).dtype == jnp.float32
    np.testing.assert_allclose(log(frame), twist, rtol=1e-6)
