from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from arms import ARMS, arm_named, over_rows, random_bends

from qjrl.config import ConfigError
from qjrl.robot import forward_kinematics, joint_positions
from qjrl.robot.quaternion_arm.urdf import build_urdf

SPHERICAL = [name for name in ARMS if arm_named(name).joint_model == "spherical"]
ROLLING = [name for name in ARMS if name not in SPHERICAL]


def loaded(text: str) -> mujoco.MjModel:
    """By MuJoCo, which wants masses, and merges fixed links unless it is told not to."""
    root = ElementTree.fromstring(text)
    settings = {"fusestatic": "false", "boundmass": "0.001", "boundinertia": "0.001", "strippath": "false"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", settings)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


@pytest.mark.parametrize("name", SPHERICAL)
def test_the_tip_of_the_urdf_is_that_of_the_closed_form(name):
    arm = arm_named(name)
    model, bends = loaded(build_urdf(arm)), random_bends(arm, 50)
    data = mujoco.MjData(model)
    for positions, pose in zip(
        over_rows(joint_positions, arm, bends), over_rows(forward_kinematics, arm, bends), strict=True
    ):
        data.qpos[:] = positions  # MuJoCo knows no mimic joints: all are set by hand
        mujoco.mj_forward(model, data)
        rotation = data.body("tip").xmat.reshape(3, 3)
        found = np.concatenate([data.body("tip").xpos, rotation[:, 0], rotation[:, 1]])
        np.testing.assert_allclose(found, pose, atol=1e-12)


@pytest.mark.parametrize("name", SPHERICAL)
def test_every_joint_repeats_one_of_its_segments_two_free_ones(name):
    arm = arm_named(name)
    joints = [one for one in ElementTree.fromstring(build_urdf(arm)).iter("joint") if one.get("type") == "revolute"]
    names = [one.attrib["name"] for one in joints]
    mimics = [one.find("mimic") for one in joints]
    leaders = [own if mimic is None else mimic.attrib["joint"] for own, mimic in zip(names, mimics, strict=True)]
    assert len(set(leaders)) == 2 * arm.num_segments
    assert all(mimic is None or mimic.attrib["multiplier"] == "1.0" for mimic in mimics)
    positions = over_rows(joint_positions, arm, random_bends(arm, 20))
    np.testing.assert_allclose(positions, positions[:, [names.index(leader) for leader in leaders]], atol=1e-15)


@pytest.mark.parametrize("name", SPHERICAL)
def test_the_limits_hold_every_bend_within_the_bend_limit(name):
    arm = arm_named(name)
    bounds = loaded(build_urdf(arm)).jnt_range
    positions = over_rows(joint_positions, arm, random_bends(arm, 500))
    assert np.all(positions >= bounds[:, 0]) and np.all(positions <= bounds[:, 1])
    np.testing.assert_allclose(bounds[:, 1], float(arm.bend_limit) / 2.0)


@pytest.mark.parametrize("name", ROLLING)
def test_rolling_joints_are_refused(name):
    with pytest.raises(ConfigError, match=f"URDF: got the robot {name}"):
        build_urdf(arm_named(name))
