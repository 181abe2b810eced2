import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import MADE_UP, arm_named, over_rows, random_bends

from qjrl.robot import forward_kinematics
from qjrl.robot.quaternion_arm.tip import tip_pose, tip_poses, tip_position


@pytest.mark.parametrize("name", ["qj_2222", "qj_huang_4332_480", *MADE_UP])
def test_the_tip_carried_back_is_the_tip_of_the_forward_kinematics(name):
    arm = arm_named(name)
    bends = random_bends(arm, 50)
    expected = over_rows(forward_kinematics, arm, bends)
    np.testing.assert_allclose(over_rows(tip_pose, arm, bends), expected, atol=1e-13)
    np.testing.assert_allclose(over_rows(tip_position, arm, bends), expected[:, :3], atol=1e-13)
    np.testing.assert_allclose(tip_poses(arm, jnp.asarray(bends)), expected, atol=1e-13)


def test_single_precision_costs_less_than_two_micrometres():
    arm = arm_named("qj_huang_4332")
    bends = random_bends(arm, 500)
    single = over_rows(tip_position, jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), arm), jnp.float32(bends))
    assert single.dtype == np.float32
    assert np.abs(single - over_rows(forward_kinematics, arm, bends)[:, :3]).max() < 2e-6
