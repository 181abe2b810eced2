"""URDF of an arm of spherical quaternion joints, exact: two hinges a segment are free, and mimic joints repeat them.

A quaternion joint is four hinges about half angles, lower x, lower y, upper y, upper x (`coordinates.joint_positions`), the
upper pair equal to the lower, and all joints of a segment alike. A rolling joint's height depends on its bend, which no URDF
says.
"""

import math
from xml.etree import ElementTree

from qjrl.config import ConfigError
from qjrl.robot.mjcf_text import add_element
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.mjcf_ties import height_at_home
from qjrl.robot.quaternion_arm.naming import first_of_segment, joint_labels


def build_urdf(arm: QuaternionArm) -> str:
    """URDF text of an arm, base link `base` at the origin, straight along z, last link `tip` with the pose's frame.

    The free joints are `lower_x_SEGMENT_1` and `lower_y_SEGMENT_1` of every segment [rad]. Their limits are a box about the
    disc of the bends: half the bend limit each. Links have neither mass nor shape: the text states kinematics alone.

    Raises:
        ConfigError: the joints roll.
    """
    if arm.joint_model != "spherical":
        raise ConfigError(f"URDF: got the robot {arm.name} with rolling joints, allowed: spherical joints alone")
    root = ElementTree.Element("robot", name=arm.name)
    add_element(root, "link", name="base")
    parent, height, link = "base", height_at_home(arm.config.joint), arm.config.link_length
    plate = 0.0  # where the joint's lower plate is along its parent's z
    for label in joint_labels(arm):
        lengths = {"lower_x": plate, "lower_y": 0.0, "upper_y": height, "upper_x": 0.0}
        for name, along in lengths.items():
            parent = _add_hinge(root, arm, parent, name, label, along)
        plate = link
    add_element(root, "link", name="tip")
    last = add_element(root, "joint", name="tip", type="fixed")
    _connect(last, parent, "tip", plate)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _add_hinge(root: ElementTree.Element, arm: QuaternionArm, parent: str, name: str, label: str, along: float) -> str:
    """A link on a hinge at `along` of its parent's z; its name. Only the first joint's lower hinges are free."""
    link, axis = f"{name}_{label}", "1 0 0" if name.endswith("x") else "0 1 0"
    add_element(root, "link", name=link)
    hinge = add_element(root, "joint", name=link, type="revolute")
    _connect(hinge, parent, link, along)
    add_element(hinge, "axis", xyz=axis)
    reach = math.radians(arm.config.joint.bend_limit_deg) / 2.0
    add_element(hinge, "limit", lower=-reach, upper=reach, effort=arm.config.motors.force, velocity=math.pi)
    leader = f"lower_{name[-1]}_{first_of_segment(label)}"
    if link != leader:
        add_element(hinge, "mimic", joint=leader, multiplier=1.0, offset=0.0)
    return link


def _connect(joint: ElementTree.Element, parent: str, child: str, along: float) -> None:
    add_element(joint, "origin", xyz=(0.0, 0.0, along), rpy=(0.0, 0.0, 0.0))
    add_element(joint, "parent", link=parent)
    add_element(joint, "child", link=child)
