"""How an arm is brought to rest: the same forces at rest, with the inertia and the friction that get there soonest.

Where an arm rests, inertia and damping do not matter. So what settles is a stand-in: the arm's springs, strands and weights,
but hinges with an armature for the stiffest mode to take `_STIFFEST` radians a step, masses so light that they hardly
count (under as much more gravity), and no damping. Instead every step takes a share of all velocities, at first the one
that damps the softest mode critically: then all modes die away alike. `settle_judging` changes that share where a row shows
that its softest mode is another, as with slack strands.
"""

import dataclasses
import math

import numpy as np

from qjrl.robot import build_mjcf
from qjrl.robot.quaternion_arm.cables import cable_matrix
from qjrl.robot.quaternion_arm.dynamics import hinge_stiffness
from qjrl.robot.quaternion_arm.joint import height_of_cosine
from qjrl.robot.quaternion_arm.mjcf import SLIDE_ARMATURE, SolverOptions
from qjrl.robot.quaternion_arm.mjcf_ties import height_at_home
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig

# Of the stiffest mode at home in one time step [rad]; beyond 2 the integration is unstable.
_STIFFEST = 1.0
# Largest inertia of the masses, relative to that of the armatures.
_LIGHT = 0.1
# A slide's inertia, relative to its hinges', seen from the joint's angle where it counts most.
_SLIDE_SHARE = 0.5
LEAST_LOSS, MOST_LOSS = 1e-4, 0.5


@dataclasses.dataclass(frozen=True)
class Relaxation:
    """What the engines simulate."""

    mjcf: str
    """Of the stand-in."""
    loss: float
    """Share of the velocities that a step takes, at first."""
    is_adaptive: bool
    """Whether each row's loss follows what the row shows."""


def relaxation(robot: Robot, config: SettleConfig) -> Relaxation:
    """Of an arm; with a `damping_scale`, the arm itself with so many times its joints' damping, as before."""
    if config.damping_scale is not None:
        return Relaxation(build_mjcf(robot, config.solver), 0.0, False)
    stiffness, unit_inertia = _stiffness(robot), 4.0 * np.repeat(robot.joints_per_segment, 2) / 2.0
    root = np.sqrt(unit_inertia)
    modes = np.linalg.eigvalsh(stiffness / np.outer(root, root))
    armature = modes[-1] * (config.timestep / _STIFFEST) ** 2
    softest = math.sqrt(max(modes[0], 0.0) / armature) * config.timestep
    slide = _SLIDE_SHARE * 2.0 * armature / max(_steepest_height(robot), 1e-9) ** 2
    options = dataclasses.replace(
        config.solver, armature_scale=slide / SLIDE_ARMATURE, damping_scale=1.0, strand_damping_scale=0.0
    )
    stand_in = _light(robot, armature, armature / options.armature_scale)
    return Relaxation(build_mjcf(stand_in, options), min(max(2.0 * softest, LEAST_LOSS), MOST_LOSS), True)


def _stiffness(robot: Robot) -> np.ndarray:
    """(coordinates, coordinates) against half angles at home [N m/rad]: two taut strands a cable, and hinges."""
    slopes = np.asarray(cable_matrix(robot), np.float64)
    return 2.0 * float(robot.strand_stiffness) * slopes.T @ slopes + np.diag(hinge_stiffness(robot))


def _steepest_height(robot: Robot) -> float:
    """Largest change of a joint's height with its half angle, up to the stop [m/rad]; 0 for the spherical joint."""
    joint = robot.config.joint
    half = np.linspace(0.0, math.radians(joint.bend_limit_deg + joint.stop_margin_deg) / 2.0, 50)
    heights = height_of_cosine(joint.crossed_link_length, joint.pin_distance, joint.plate_to_pin, np.cos(half))
    return float(np.abs(np.gradient(heights, half)).max())


def _light(robot: Robot, inertia: float, armature: float) -> Robot:
    """The arm with masses whose inertia is small against `inertia` a hinge, under as much more gravity; no damping."""
    config, mechanics = robot.config, robot.config.mechanics
    length = robot.num_joints * (height_at_home(config.joint) + config.link_length) + mechanics.link_radius
    mass = robot.num_joints * (mechanics.joint_mass + mechanics.link_mass) + mechanics.payload
    largest = mass * length**2 * 4.0 * sum(robot.joints_per_segment)  # per hinge pair of armatures, in the softest case
    lightness = min(1.0, _LIGHT * 2.0 * inertia / largest)
    light = dataclasses.replace(
        mechanics,
        joint_mass=lightness * mechanics.joint_mass,
        link_mass=lightness * mechanics.link_mass,
        payload=lightness * mechanics.payload,
        gravity=tuple(component / lightness for component in mechanics.gravity),
        armature=armature,
        joint_damping=0.0,
    )
    return robot.replace(config=dataclasses.replace(config, mechanics=light))
