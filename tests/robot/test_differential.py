import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, random_bends

from qjrl.robot import forward_kinematics
from qjrl.robot.quaternion_arm import differential
from qjrl.robot.quaternion_arm.joint import joint_transform

ARM = arm_named("rolling_312")
tip_of = jax.jit(differential.tip_of)
segment_end = jax.jit(differential.segment_end, static_argnums=1)


def vectors_of(bends):
    """theta (cos phi, sin phi) of bends."""
    sine = np.linalg.norm(bends, axis=-1, keepdims=True)
    return bends * np.where(sine == 0.0, 2.0, 2.0 * np.arcsin(sine) / np.where(sine == 0.0, 1.0, sine))


def bend_of(vector):
    return 0.5 * jnp.sinc(jnp.sqrt(jnp.sum(vector**2)) / (2.0 * jnp.pi)) * vector


def pose_of(vectors):
    return forward_kinematics(ARM, jax.vmap(bend_of)(vectors))


def batch(rows):
    return jnp.asarray(np.moveaxis(rows, 0, -1))


VECTORS = vectors_of(random_bends(ARM, 6))
VECTORS[0] = 1e-4  # nearly straight, where the closed form divides small numbers


def test_the_tip_is_that_of_the_forward_kinematics():
    tip = tip_of(ARM, batch(VECTORS))
    found = jnp.concatenate([tip.position, tip.rotation[:, 0], tip.rotation[:, 1]]).T
    np.testing.assert_allclose(found, jax.jit(jax.vmap(pose_of))(VECTORS), atol=1e-13)


def test_the_jacobian_is_the_derivative_of_the_forward_kinematics():
    tip = tip_of(ARM, batch(VECTORS))
    rates = np.asarray(jax.jit(jax.vmap(jax.jacfwd(pose_of)))(VECTORS)).reshape(6, 9, -1)
    np.testing.assert_allclose(np.moveaxis(tip.velocity, -1, 0), rates[:, :3], atol=1e-9)
    for column in (0, 1):  # a column x of the rotation moves with w x x
        turned = np.cross(tip.angular_velocity, np.asarray(tip.rotation)[:, None, column], axis=0)
        np.testing.assert_allclose(np.moveaxis(turned, -1, 0), rates[:, 3 + 3 * column : 6 + 3 * column], atol=1e-8)


def test_a_straight_arm_has_a_jacobian():
    straight, nearly = (tip_of(ARM, jnp.full((3, 2, 6), size)) for size in (0.0, 1e-7))
    for exact, near in zip(jax.tree.leaves(straight), jax.tree.leaves(nearly), strict=True):
        np.testing.assert_allclose(exact, near, atol=1e-5)


@pytest.mark.parametrize("count", range(1, 7))
def test_a_segment_is_its_joints_and_links_one_after_the_other(count):
    vector = jnp.array([0.3, -0.35])
    position, rotation = np.zeros(3), np.eye(3)
    offset, turn = (np.asarray(part) for part in joint_transform(ARM, bend_of(vector)))
    for _ in range(count):
        position, rotation = position + rotation @ offset, rotation @ turn
        position = position + rotation[:, 2] * float(ARM.link_length)
    end = segment_end(ARM, count, vector)
    np.testing.assert_allclose(end.position, position, atol=1e-14)
    np.testing.assert_allclose(end.rotation, rotation, atol=1e-14)
