"""Strands as tendon limits: the same arm without servos, held where the closed form says."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from arms import arm_named, random_bends

from qjrl.robot import build_mjcf, cable_lengths, joint_positions, strand_lengths
from qjrl.robot.quaternion_arm.limited_strands import held_strand_lengths, limit_strands


@pytest.mark.parametrize("name", ["qj_22", "spherical_312"])
def test_only_the_strands_change(name):
    arm = arm_named(name)
    servos = mujoco.MjModel.from_xml_string(build_mjcf(arm))
    limits = mujoco.MjModel.from_xml_string(limit_strands(build_mjcf(arm)))
    strands = slice(0, arm.num_strands)
    assert limits.nu == 0 and servos.nu == arm.num_strands
    assert limits.tendon_limited[strands].all() and not servos.tendon_limited[strands].any()
    np.testing.assert_array_equal(limits.tendon_limited[arm.num_strands :], servos.tendon_limited[arm.num_strands :])
    for field in (
        "body_mass",
        "dof_armature",
        "dof_damping",
        "tendon_damping",
        "tendon_length0",
        "eq_data",
        "eq_solimp",
    ):
        np.testing.assert_array_equal(getattr(limits, field), getattr(servos, field), err_msg=field)


@pytest.mark.parametrize("name", ["qj_22", "rolling_312"])
def test_ranges_are_centred_on_what_the_physics_measures_at_the_nominal_bends(name):
    arm = arm_named(name)
    bends = jnp.asarray(random_bends(arm, 1, seed=2)[0])
    centres = held_strand_lengths(arm, cable_lengths(arm, bends))
    np.testing.assert_allclose(centres, strand_lengths(arm, bends), atol=1e-12)
    model = mujoco.MjModel.from_xml_string(limit_strands(build_mjcf(arm)))
    data = mujoco.MjData(model)
    data.qpos[:] = np.asarray(joint_positions(arm, bends))
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.ten_length[: arm.num_strands], centres, atol=1e-7)
