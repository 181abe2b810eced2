"""What is simulated to bring an arm to rest: a stand-in with the arm's forces, and the inertia that gets there soonest.

Where an arm rests, inertia and damping do not matter. So the stand-in has the arm's springs, strands and weights, but hinges
with an armature for which the stiffest mode turns by `STIFFEST` radians a time step, masses so light that they hardly
count, under as much more gravity, and no damping. `settle_rule` damps it. So no time constant of the arm is left.
"""

import dataclasses
import math

import numpy as np

from qjrl.robot import build_mjcf
from qjrl.robot.quaternion_arm.cables import cable_matrix
from qjrl.robot.quaternion_arm.dynamics import hinge_stiffness
from qjrl.robot.quaternion_arm.joint import height_of_cosine
from qjrl.robot.quaternion_arm.mjcf import SLIDE_ARMATURE
from qjrl.robot.quaternion_arm.mjcf_ties import height_at_home
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settle_rule import critical_loss

STIFFEST = 1.0
"""Phase of the stiffest mode at home in one time step [rad]; from 2 on the integration is unstable."""
# Inertia of the masses at most, relative to the armatures'.
_LIGHT = 0.1
# Inertia of a joint's slide, seen from its half angle where the height changes most, relative to its hinges'.
_SLIDE_SHARE = 0.5


@dataclasses.dataclass(frozen=True)
class Relaxation:
    """What the engines simulate."""

    mjcf: str
    """Of the stand-in, or of the arm itself with more damping."""
    loss: float | None
    """Share of the velocities that a time step takes at first, see `settle_rule`; None: the joints' damping is all there is."""


def relaxation(robot: Robot, config: SettleConfig) -> Relaxation:
    """Of an arm: the stand-in, or where `damping_scale` is a number the arm itself with so many times its joints' damping."""
    if config.damping_scale is not None:
        return Relaxation(build_mjcf(robot, config.solver), None)
    inertia = 2.0 * np.repeat(robot.joints_per_segment, 2)  # of a half angle, for each unit of its hinges' armature
    modes = np.linalg.eigvalsh(_stiffness(robot) / np.sqrt(np.outer(inertia, inertia)))
    armature = modes[-1] * (config.timestep / STIFFEST) ** 2
    steepest = _steepest_height(robot)
    slide = _SLIDE_SHARE * 2.0 * armature / steepest**2 if steepest > 0.0 else SLIDE_ARMATURE
    options = dataclasses.replace(config.solver, armature_scale=slide / SLIDE_ARMATURE, strand_damping_scale=0.0)
    stand_in = _stand_in(robot, armature, options.armature_scale)
    loss = critical_loss(np, np.float64(modes[0] / armature * config.timestep**2))
    return Relaxation(build_mjcf(stand_in, options), float(loss))


def _stiffness(robot: Robot) -> np.ndarray:
    """(coordinates, coordinates) against half angles at home [N m/rad]: two taut strands a cable, and hinges."""
    slopes = np.asarray(cable_matrix(robot), np.float64)
    return 2.0 * float(robot.strand_stiffness) * slopes.T @ slopes + np.diag(hinge_stiffness(robot))


def _steepest_height(robot: Robot) -> float:
    """Largest change of a joint's height with its half angle, up to the stop [m/rad]; 0 for the spherical joint."""
    joint = robot.config.joint
    half = np.linspace(0.0, math.radians(joint.bend_limit_deg + joint.stop_margin_deg) / 2.0, 50)
    heights = height_of_cosine(joint.crossed_link_length, joint.pin_distance, joint.plate_to_pin, np.cos(half))
    return float(np.abs(np.gradient(heights, half)).max()) if robot.joint_model == "rolling" else 0.0


def _stand_in(robot: Robot, armature: float, scale: float) -> Robot:
    """The arm with an armature [kg m^2] that is multiplied by `scale` later, light masses and no damping."""
    config, mechanics = robot.config, robot.config.mechanics
    length = robot.num_joints * (height_at_home(config.joint) + config.link_length) + mechanics.link_radius
    mass = robot.num_joints * (mechanics.joint_mass + mechanics.link_mass) + mechanics.payload
    lightness = min(
        1.0, _LIGHT * armature / (2.0 * robot.num_joints * mass * length**2)
    )  # all of it at the tip at most
    stand_in = dataclasses.replace(
        mechanics,
        joint_mass=lightness * mechanics.joint_mass,
        link_mass=lightness * mechanics.link_mass,
        payload=lightness * mechanics.payload,
        gravity=tuple(component / lightness for component in mechanics.gravity),
        armature=armature / scale,
        joint_damping=0.0,
    )
    return dataclasses.replace(robot, config=dataclasses.replace(config, mechanics=stand_in))
