import jax
import numpy as np
import pytest
from arms import ARMS, arm_named, over_rows, random_bends

from qjrl.robot import configuration_from_joint_positions, joint_positions


@pytest.mark.parametrize("name", ARMS)
def test_bends_come_back_from_joint_positions(name):
    arm = arm_named(name)
    bends = random_bends(arm, 20)
    positions = over_rows(joint_positions, arm, bends)
    assert positions.shape == (20, arm.num_joints * (5 if arm.joint_model == "rolling" else 4))
    np.testing.assert_allclose(over_rows(configuration_from_joint_positions, arm, positions), bends, atol=1e-15)


def test_home_is_all_zeros():
    arm = arm_named("qj_2222")
    np.testing.assert_array_equal(over_rows(joint_positions, arm, np.zeros((1, 4, 2))), 0.0)


def test_a_mismatch_between_the_joints_of_a_segment_is_averaged():
    arm = arm_named("qj_22")
    low, high = over_rows(joint_positions, arm, random_bends(arm, 2))
    mixed = np.concatenate([low[:5], high[5:10], low[10:]])
    bends = over_rows(configuration_from_joint_positions, arm, np.stack([low, high, mixed]))
    np.testing.assert_allclose(bends[2, 0], (bends[0, 0] + bends[1, 0]) / 2, atol=1e-15)
    np.testing.assert_allclose(bends[2, 1], bends[0, 1], atol=1e-15)


def test_derivatives_at_home_are_finite():
    arm = arm_named("qj_22")
    jacobian = jax.jit(jax.jacrev(lambda bends: joint_positions(arm, bends)))
    assert np.isfinite(jacobian(np.zeros((2, 2)))).all()
