"""Robots by kind: load a description, then kinematics, cables and physics through one set of verbs.

A `configuration` is what a kind calls its own minimal coordinates; for `quaternion_arm` it is the bends
a_k = sin(theta_k/2) (cos phi_k, sin phi_k), shape (num_segments, 2). Every verb takes one sample; callers vmap.
"""

from qjrl.robot.loading import load_robot, robot_from_mapping, robot_hash
from qjrl.robot.verbs import (
    bends_from_angles,
    bends_from_cables,
    bends_from_pose,
    build_mjcf,
    cable_lengths,
    cable_strokes,
    configuration_from_joint_positions,
    equilibrium,
    forward_kinematics,
    in_precision,
    joint_positions,
    strand_commands,
    strand_lengths,
    strand_tension,
)

__all__ = [
    "bends_from_angles",
    "bends_from_cables",
    "bends_from_pose",
    "build_mjcf",
    "cable_lengths",
    "cable_strokes",
    "configuration_from_joint_positions",
    "equilibrium",
    "forward_kinematics",
    "in_precision",
    "joint_positions",
    "load_robot",
    "robot_from_mapping",
    "robot_hash",
    "strand_commands",
    "strand_lengths",
    "strand_tension",
]
