import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, over_rows, random_bends

from qjrl.control.sensors import exact_reading
from qjrl.control.tip_correction import (
    LEVER,
    IntegralConfig,
    damped_pseudo_inverse,
    integrate,
    sensed_pose,
    tip_error,
)
from qjrl.geometry.pose import pose_from_frame
from qjrl.geometry.rotations import rotation_z
from qjrl.robot import bends_from_cables, cable_lengths, forward_kinematics

ARMS = ["qj_2222", "rolling_312"]


def tip(arm, lengths):
    return forward_kinematics(arm, bends_from_cables(arm, lengths))


@pytest.mark.parametrize("name", ARMS)
def test_without_damping_a_small_difference_is_made_up_in_one_step(name):
    """Newton's step: what is left is of second order."""
    arm = arm_named(name)
    lengths = jnp.asarray(over_rows(cable_lengths, arm, random_bends(arm, 1, seed=3))[0])
    moved = lengths + 1e-5 * np.random.default_rng(0).normal(size=arm.num_cables)
    target = tip(arm, moved)
    difference = tip_error(tip(arm, lengths), target)
    correction = damped_pseudo_inverse(arm, lengths, damping=1e-6)
    left = tip_error(tip(arm, lengths + correction @ difference), target)
    assert float(jnp.linalg.norm(left)) < 1e-3 * float(jnp.linalg.norm(difference))


def test_at_home_where_the_arm_cannot_lengthen_damping_keeps_the_cables_still():
    arm = arm_named("qj_2222")
    correction = damped_pseudo_inverse(arm, jnp.zeros(arm.num_cables))
    assert np.abs(correction).max() < 1.0  # never more cable than tip
    up = correction @ jnp.array([0.0, 0.0, 1e-3, 0.0, 0.0, 0.0])
    aside = correction @ jnp.array([1e-3, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert float(jnp.linalg.norm(up)) < 1e-3 * float(jnp.linalg.norm(aside))


def test_the_difference_is_a_shift_and_a_turn_of_the_lever():
    pose = pose_from_frame(jnp.array([0.1, 0.2, 0.3]), rotation_z(jnp.asarray(0.4)))
    target = pose_from_frame(jnp.array([0.11, 0.2, 0.27]), rotation_z(jnp.asarray(0.7)))
    expected = [0.01, 0.0, -0.03, 0.0, 0.0, 0.3 * LEVER]
    np.testing.assert_allclose(tip_error(pose, target), expected, atol=1e-12)
    np.testing.assert_allclose(tip_error(pose, pose), np.zeros(6), atol=1e-15)


def test_the_sensed_pose_of_exact_encoders_is_the_kinematics():
    arm = arm_named("qj_2222")
    bends = jnp.asarray(random_bends(arm, 1)[0])
    np.testing.assert_allclose(sensed_pose(arm, exact_reading(arm, bends)), forward_kinematics(arm, bends), atol=1e-12)


def test_the_integral_of_a_constant_difference_grows_by_the_gain_up_to_its_bound():
    config, correction = IntegralConfig(gain=2.0, bound=0.001), jnp.eye(8)[:, :6]
    difference = jnp.array([0.001, -0.002, 0.0, 0.0, 0.0, 0.0])
    step = jax.jit(lambda integral: integrate(config, jnp.array(config.gain), integral, correction, difference, 0.02))
    integral = jnp.zeros(8)
    for _ in range(10):
        integral = step(integral)
    np.testing.assert_allclose(integral[:2], [2.0 * 0.2 * 0.001, -2.0 * 0.2 * 0.002], atol=1e-12)
    for _ in range(100):
        integral = step(integral)
    np.testing.assert_allclose(integral, [0.001, -0.001, 0, 0, 0, 0, 0, 0], atol=1e-12)


def test_no_gain_is_no_feedback():
    integral = integrate(IntegralConfig(), jnp.array(0.0), jnp.zeros(8), jnp.ones((8, 6)), jnp.ones(6), 0.02)
    np.testing.assert_array_equal(integral, np.zeros(8))
