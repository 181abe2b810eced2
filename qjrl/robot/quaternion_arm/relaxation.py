"""The stand-in that is simulated to bring an arm to rest: its forces, and the inertia that gets there soonest.

It has the arm's springs, strands and weights, but hinges with an armature for which the stiffest mode turns by a given
phase in a time step, masses so light that they hardly count, under as much more gravity, and no damping.
"""

import dataclasses

import numpy as np

from qjrl.robot.kind import StandIn
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.cables import cable_matrix
from qjrl.robot.quaternion_arm.dynamics import hinge_stiffness
from qjrl.robot.quaternion_arm.joint import height_of_cosine
from qjrl.robot.quaternion_arm.mjcf import SLIDE_ARMATURE, build_mjcf
from qjrl.robot.quaternion_arm.mjcf_ties import straight_length
from qjrl.robot.solver_options import SolverOptions

# Inertia of the masses at most, relative to the armatures'.
_LIGHT = 0.1
# Inertia of a joint's slide, seen from its half angle where the height changes most, relative to its hinges'.
_SLIDE_SHARE = 0.5


def stand_in(arm: QuaternionArm, options: SolverOptions, phase: float) -> StandIn:
    """What is simulated in the arm's place.

    Args:
        options: of the physics; armature and strand damping are the stand-in's own.
        phase: of the stiffest mode at home in one time step [rad].
    """
    inertia = 2.0 * np.repeat(arm.joints_per_segment, 2)  # of a half angle, for each unit of its hinges' armature
    modes = np.linalg.eigvalsh(_stiffness(arm) / np.sqrt(np.outer(inertia, inertia)))
    armature = modes[-1] * (options.timestep / phase) ** 2
    steepest = _steepest_height(arm)
    slide = _SLIDE_SHARE * 2.0 * armature / steepest**2 if steepest > 0.0 else SLIDE_ARMATURE
    own = dataclasses.replace(options, armature_scale=slide / SLIDE_ARMATURE, strand_damping_scale=0.0)
    mjcf = build_mjcf(_light(arm, armature, own.armature_scale), own)
    return StandIn(mjcf, float(modes[0] / armature))


def _stiffness(arm: QuaternionArm) -> np.ndarray:
    """(coordinates, coordinates) against half angles at home [N m/rad]: two taut strands a cable, and hinges."""
    slopes = np.asarray(cable_matrix(arm), np.float64)
    return 2.0 * float(arm.strand_stiffness) * slopes.T @ slopes + np.diag(hinge_stiffness(arm))


def _steepest_height(arm: QuaternionArm) -> float:
    """Largest change of a joint's height with its half angle, up to the stop [m/rad]; 0 for the spherical joint."""
    joint = arm.config.joint
    half = np.linspace(0.0, float(arm.stop) / 2.0, 50)
    heights = height_of_cosine(joint.crossed_link_length, joint.pin_distance, joint.plate_to_pin, np.cos(half))
    return float(np.abs(np.gradient(heights, half)).max()) if arm.joint_model == "rolling" else 0.0


def _light(arm: QuaternionArm, armature: float, scale: float) -> QuaternionArm:
    """The arm with an armature [kg m^2] that is multiplied by `scale` later, light masses and no damping."""
    length = straight_length(arm) + float(arm.link_radius)
    mass = arm.num_joints * float(arm.joint_mass + arm.link_mass) + float(arm.payload)
    lightness = min(1.0, _LIGHT * armature / (2.0 * arm.num_joints * mass * length**2))  # all of it at the tip at most
    return dataclasses.replace(
        arm,
        joint_mass=lightness * arm.joint_mass,
        link_mass=lightness * arm.link_mass,
        payload=lightness * arm.payload,
        gravity=arm.gravity / lightness,
        armature=armature / scale,
        joint_damping=0.0,
    )
