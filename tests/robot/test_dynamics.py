"""Minimal coordinates against MuJoCo's own mass matrix, bias forces, tendons and sites on the constraint manifold."""

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from arms import arm_named

from qjrl.robot import build_mjcf, joint_positions
from qjrl.robot.quaternion_arm import dynamics
from qjrl.xla_options import CPU_COMPILER_OPTIONS

ARMS = [
    "qj_22",
    pytest.param("qj_2222", marks=pytest.mark.slow),
    pytest.param("qj_2222_spherical", marks=pytest.mark.slow),
    pytest.param("qj_huang_4332", marks=pytest.mark.slow),
]


EQUATIONS = jax.jit(dynamics.equations_of_motion, compiler_options=CPU_COMPILER_OPTIONS)


def positions_of(arm, half_angles):
    x, y = half_angles[:, 0], half_angles[:, 1]
    return joint_positions(arm, jnp.stack([jnp.sin(y), -jnp.sin(x) * jnp.cos(y)], axis=1))


def drawn(arm, seed=0):
    """Half angles within the limit and rates of motion, from home to far."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-1, 1, (arm.num_segments, 2)) * float(arm.bend_limit) / 2.9
    return jnp.asarray(angles), jnp.asarray(rng.normal(size=(arm.num_segments, 2)))


def equations(arm, angles, rates, gravity: Any = (0.0, 0.0, -9.81), scale: Any = 1.0):
    payload = jnp.asarray(arm.config.mechanics.payload)
    load = dynamics.Load(jnp.asarray(gravity), jnp.asarray(scale), payload)
    return EQUATIONS(arm, load, angles, rates)


def mujoco_at(arm, half_angles, rates, gravity=(0.3, -0.2, -9.81)):
    """MuJoCo on the manifold, moving along it: model, data, d qpos / d half angles, and what of the acceleration is not
    due to that of the half angles."""
    model = mujoco.MjModel.from_xml_string(build_mjcf(arm))
    model.opt.gravity[:] = gravity
    data = mujoco.MjData(model)
    flat = lambda vector: positions_of(arm, vector.reshape(half_angles.shape))  # noqa: E731
    along = lambda vector: jax.jvp(flat, (vector,), (rates.reshape(-1),))[1]  # noqa: E731
    base = half_angles.reshape(-1)
    slope = np.asarray(jax.jacfwd(flat)(base))
    extra = np.asarray(jax.jvp(along, (base,), (rates.reshape(-1),))[1])
    data.qpos[:], data.qvel[:] = np.asarray(flat(base)), np.asarray(along(base))
    mujoco.mj_forward(model, data)
    return model, data, slope, extra


@pytest.mark.parametrize("name", ARMS)
def test_strands_are_those_of_mujoco_and_cosines_those_of_the_joints(name):
    arm = arm_named(name)
    angles, rates = drawn(arm)
    _, data, _, _ = mujoco_at(arm, angles, rates)
    found = equations(arm, angles, rates)
    np.testing.assert_allclose(found.strands, data.ten_length[: arm.num_strands], atol=1e-12)
    slope = np.asarray(found.strand_slope)
    np.testing.assert_allclose(rates.reshape(-1) @ slope, data.ten_velocity[: arm.num_strands], atol=1e-10)
    cosines = lambda flat: jnp.prod(jnp.cos(flat.reshape(angles.shape)), axis=1)  # noqa: E731
    np.testing.assert_allclose(found.cosines, cosines(angles.reshape(-1)), atol=1e-14)
    np.testing.assert_allclose(found.cosine_slope.T, jax.jacfwd(cosines)(angles.reshape(-1)), atol=1e-14)


@pytest.mark.parametrize("name", ARMS)
def test_mass_matrix_is_mujocos_along_the_manifold(name):
    arm = arm_named(name)
    angles, rates = drawn(arm)
    model, data, slope, _ = mujoco_at(arm, angles, rates)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    found = equations(arm, angles, rates).mass
    np.testing.assert_allclose(found, slope.T @ full @ slope, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_gravity_and_coriolis_forces_are_mujocos_along_the_manifold(name):
    arm, gravity = arm_named(name), np.array([0.3, -0.2, -9.81])
    angles, rates = drawn(arm)
    model, data, slope, extra = mujoco_at(arm, angles, rates, gravity)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    found = equations(arm, angles, rates, gravity).force
    np.testing.assert_allclose(-found, slope.T @ (data.qfrc_bias + full @ extra), rtol=1e-8, atol=1e-11)


@pytest.mark.slow
def test_a_batch_last_equals_one_arm_at_a_time():
    arm = arm_named("qj_22")
    drawn_rows = [drawn(arm, seed) for seed in range(3)]
    angles, rates = (jnp.stack(rows, axis=-1) for rows in zip(*drawn_rows, strict=True))
    together = equations(arm, angles, rates, scale=jnp.ones(3), gravity=jnp.array([[0.0], [0.0], [-9.81]]))
    for row, (angle, rate) in enumerate(drawn_rows):
        alone = equations(arm, angle, rate)
        for many, one in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(many[..., row], one, atol=1e-13)
