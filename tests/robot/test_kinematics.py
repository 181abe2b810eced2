import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import ARMS, arm_named, joint_matrix, over_rows, random_bends

from qjrl.geometry.pose import orientation_error
from qjrl.robot import cable_lengths, forward_kinematics, load_robot, strand_lengths
from qjrl.robot.quaternion_arm.kinematics import frames

TOTAL_LENGTH_MM = {
    "qj_2222": 480,
    "qj_2222_spherical": 480,
    "qj_22": 240,
    "qj_huang_4332": 720,
    "qj_huang_4332_480": 480,
}


@pytest.mark.parametrize(("name", "length_mm"), TOTAL_LENGTH_MM.items())
def test_at_home_the_arm_stands_straight_at_its_full_length(name, length_mm):
    arm = load_robot(name)
    (pose,) = over_rows(forward_kinematics, arm, np.zeros((1, arm.num_segments, 2)))
    np.testing.assert_allclose(pose[:3] * 1e3, [0.0, 0.0, length_mm], atol=0.05)
    np.testing.assert_allclose(pose[3:], [1, 0, 0, 0, 1, 0], atol=1e-15)


@pytest.mark.parametrize("name", ARMS)
def test_the_tip_is_the_product_of_joint_and_link_transforms(name):
    """Paper 000: Eq. 2 and Eq. 3 multiplied along the chain, as 4x4 matrices in numpy."""
    arm = arm_named(name)
    link, rows, expected = np.eye(4), random_bends(arm, 10), []
    link[2, 3] = arm.config.link_length
    for bends in rows:
        chain = np.eye(4)
        for segment, count in enumerate(arm.joints_per_segment):
            chain = chain @ np.linalg.matrix_power(joint_matrix(arm, bends[segment]) @ link, count)
        expected.append(np.concatenate([chain[:3, 3], chain[:3, 0], chain[:3, 1]]))
    np.testing.assert_allclose(over_rows(forward_kinematics, arm, rows), expected, atol=1e-14)


@pytest.mark.parametrize("name", ["qj_2222", "rolling_312"])
def test_frames_run_from_the_first_plate_to_the_tip(name):
    arm = arm_named(name)
    bends = random_bends(arm, 1)
    poses = over_rows(frames, arm, bends)[0]
    assert poses.shape == (2 * arm.num_joints, 9)
    np.testing.assert_allclose(over_rows(forward_kinematics, arm, bends)[0], poses[-1], atol=1e-15)


def test_a_turn_of_all_bend_directions_turns_the_tip_about_the_base_axis():
    arm = load_robot("qj_2222")
    bends = random_bends(arm, 1)[0]
    turn = np.array([[np.cos(0.8), -np.sin(0.8)], [np.sin(0.8), np.cos(0.8)]])
    before, after = over_rows(forward_kinematics, arm, np.stack([bends, bends @ turn.T]))
    np.testing.assert_allclose(after[:2], turn @ before[:2], atol=1e-15)
    assert after[2] == pytest.approx(before[2], abs=1e-15)


def test_batches_by_vmap_over_configurations_and_over_arms():
    arm = load_robot("qj_22")
    bends = random_bends(arm, 5)
    batched = over_rows(forward_kinematics, arm, bends)
    assert batched.shape == (5, 9)
    np.testing.assert_allclose(batched[3], over_rows(forward_kinematics, arm, bends[3:4])[0], atol=1e-15)
    arms = jax.tree.map(lambda leaf: jnp.stack([leaf, 1.1 * leaf]), arm)
    poses = jax.jit(jax.vmap(lambda one: forward_kinematics(one, jnp.asarray(bends[0]))))(arms)
    np.testing.assert_allclose(poses[0], batched[0], atol=1e-15)
    np.testing.assert_allclose(poses[1, :3], 1.1 * poses[0, :3], atol=1e-15)


def lengths_pose_and_error(arm, bends):
    target = jnp.array([0, 0, 0.24, 1, 0, 0, 0, 1, 0], bends.dtype)
    pose = forward_kinematics(arm, bends)
    return cable_lengths(arm, bends), strand_lengths(arm, bends), pose, orientation_error(pose, target)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_derivatives_at_home_are_finite_and_keep_the_precision(dtype):
    arm = jax.tree.map(lambda leaf: leaf.astype(dtype), load_robot("qj_22"))
    home = jnp.zeros((2, 2), dtype)
    values, tangents = jax.jit(lambda x: jax.jvp(lambda y: lengths_pose_and_error(arm, y), (x,), (jnp.ones_like(x),)))(
        home
    )
    gradients = jax.jit(jax.jacrev(lambda x: lengths_pose_and_error(arm, x)))(home)
    for result in (*values, *tangents, *gradients):
        assert result.dtype == dtype
        assert np.isfinite(result).all()


def test_the_jacobian_agrees_with_finite_differences():
    arm = load_robot("qj_22")
    flat = jax.jit(lambda x: forward_kinematics(arm, x.reshape(2, 2)))
    x, step = jnp.asarray(random_bends(arm, 1)[0].reshape(-1)), 1e-6
    differences = np.stack([(flat(x + step * e) - flat(x - step * e)) / (2 * step) for e in np.eye(4)], axis=1)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(flat))(x), differences, atol=1e-9)
