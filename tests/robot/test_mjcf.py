import mujoco
import numpy as np
import pytest
from arms import ARMS, arm_named, over_rows, random_bends

from qjrl.robot import build_mjcf, forward_kinematics, joint_positions, strand_commands, strand_lengths
from qjrl.robot.quaternion_arm.naming import joint_labels, strand_name
from qjrl.robot.solver_options import SolverOptions


def compiled(arm, options: SolverOptions = SolverOptions()):
    model = mujoco.MjModel.from_xml_string(build_mjcf(arm, options))
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("name", ARMS)
def test_on_the_constraint_manifold_the_physics_is_the_closed_form(name):
    """Tendon lengths to 1e-8 m, the tip to 1e-9 m, every equality row to 1e-8, at random bends up to the limit."""
    arm = arm_named(name)
    model, data = compiled(arm)
    bends = random_bends(arm, 50)
    lengths, poses = over_rows(strand_lengths, arm, bends), over_rows(forward_kinematics, arm, bends)
    for row, positions in enumerate(over_rows(joint_positions, arm, bends)):
        data.qpos[:] = positions
        mujoco.mj_forward(model, data)
        tip = data.site("tip")
        pose = np.concatenate([tip.xpos, tip.xmat.reshape(3, 3)[:, 0], tip.xmat.reshape(3, 3)[:, 1]])
        np.testing.assert_allclose(data.ten_length[: arm.num_strands], lengths[row], atol=1e-8)
        np.testing.assert_allclose(pose, poses[row], atol=1e-9)
        assert np.abs(data.efc_pos[: data.ne]).max() < 1e-8
        assert data.nefc == data.ne  # no limit touches within the bend limit


@pytest.mark.parametrize("name", ARMS)
def test_the_model_has_a_strand_an_actuator_and_a_control_in_the_order_of_the_closed_form(name):
    arm = arm_named(name)
    model, data = compiled(arm)
    assert model.nu == arm.num_strands
    names = [strand_name(arm, strand) for strand in range(arm.num_strands)]
    assert [model.actuator(index).name for index in range(model.nu)] == names
    assert [model.tendon(index).name for index in range(model.nu)] == names
    np.testing.assert_array_equal(model.actuator_forcerange, [[-arm.config.strands.strength, 0.0]] * model.nu)
    data.ctrl[:] = over_rows(strand_commands, arm, np.zeros((1, arm.num_cables)))[0]
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(-data.actuator_force, arm.config.strands.pretension, rtol=1e-9)


def test_the_paper_arm_has_the_specified_size():
    arm = arm_named("qj_2222")
    model, data = compiled(arm)
    mujoco.mj_forward(model, data)
    assert (model.nv, data.ne, model.nu) == (40, 32, 16)
    assert joint_labels(arm) == ["1_1", "1_2", "2_1", "2_2", "3_1", "3_2", "4_1", "4_2"]
    assert strand_name(arm, 0) == "strand_1_a"
    assert strand_name(arm, 15) == "strand_8_b"


@pytest.mark.parametrize("name", ["qj_2222", "spherical_312"])
def test_masses_stiffness_damping_and_payload_are_the_described_ones(name):
    arm = arm_named(name)
    mechanics, model = arm.config.mechanics, compiled(arm)[0]
    expected = arm.num_joints * (mechanics.joint_mass + mechanics.link_mass) + mechanics.payload
    assert model.body_mass.sum() == pytest.approx(expected, rel=1e-12)
    hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    assert hinges.sum() == 4 * arm.num_joints
    # A joint bent by theta in the x-z plane turns two hinges by theta/2 each: 2 * (1/2) (2K) (theta/2)^2 = (1/2) K theta^2.
    np.testing.assert_allclose(model.jnt_stiffness[hinges].ravel()[: hinges.sum()], 2.0 * mechanics.joint_stiffness)
    np.testing.assert_allclose(model.dof_damping[model.jnt_dofadr[hinges]].ravel(), 2.0 * mechanics.joint_damping)
    np.testing.assert_allclose(model.dof_armature[model.jnt_dofadr[hinges]], mechanics.armature)


def test_solver_options_scale_what_they_name():
    arm = arm_named("qj_22")
    plain, scaled = compiled(arm)[0], compiled(arm, SolverOptions(0.002, 0.016, 3.0, 10.0, 50))[0]
    assert (scaled.opt.timestep, scaled.opt.iterations) == (0.002, 50)
    hinges = plain.jnt_dofadr[plain.jnt_type == mujoco.mjtJoint.mjJNT_HINGE]
    np.testing.assert_allclose(scaled.dof_armature[hinges], 3.0 * plain.dof_armature[hinges])
    np.testing.assert_allclose(scaled.dof_damping[hinges], 10.0 * plain.dof_damping[hinges])
    np.testing.assert_allclose(scaled.eq_solref[:, 0], 0.016)
