"""MJCF of the arm: hinges on half angles, one slide for the rolling joint's height, pull-only strand pairs.

One joint is two half-angle universal joints: hinges x, y -- chord -- hinges y, x with equal halves. By mirror symmetry
that is exactly the joint of Eq. 2, and cos(theta/2) = cos x cos y. The rolling joint adds one slide along the chord,
tied to theta through a measuring tendon whose length 2 c cos(theta/4) depends on theta alone. Compliance enters as
named physical values only (joint stiffness, strand stiffness); equality rows are hard.
"""

import dataclasses
import math
from typing import Annotated
from xml.etree import ElementTree

import numpy as np

from qjrl.config import ConfigError, Range
from qjrl.robot.quaternion_arm.description import QuaternionArm
from qjrl.robot.quaternion_arm.joint import height_of_cosine

# Sites of the measuring tendon lie this far from the pivots [m]; any value serves, near the joint's size is best.
MEASURING_ARM = 0.030
# Nearly rigid rows. With MuJoCo's default impedance the tip rests 6 mm off and moves with armature and solref.
HARD_SOLIMP = "0.9999 0.9999 0.001 0.5 2"
# Inertia of the slide [kg]. A height row is soft in proportion to its inverse: at 1 kg the tip rests 0.03 mm below the
# minimum of the potential energy, at 10 kg 0.005 mm. Small against the hinges' while dH/dtheta stays below 5 mm/rad.
SLIDE_ARMATURE = 10.0
# The slide follows the closed form this closely [m]; 2e-9 for the default arm.
LARGEST_FIT_ERROR = 1e-6


@dataclasses.dataclass(frozen=True)
class SolverOptions:
    """Numerical settings of the physics: the settled pose must not depend on any of them."""

    timestep: Annotated[float, Range(low=1e-4, high=0.006)] = 0.004
    """Time step [s]; above 6 ms the strands' stiffness makes the integration chatter."""
    equality_time_constant: Annotated[float, Range(low=0.001, high=0.1)] = 0.008
    """First number of solref of the equality rows [s], at least two time steps."""
    armature_scale: Annotated[float, Range(low=0.1, high=10.0)] = 1.0
    """Factor on every armature."""
    damping_scale: Annotated[float, Range(low=0.1, high=100.0)] = 1.0
    """Factor on the joints' damping: speeds up settling, leaves the equilibrium where it is."""
    solver_iterations: Annotated[int, Range(low=1, high=100)] = 20
    """Newton iterations at most."""


def build_mjcf(arm: QuaternionArm, options: SolverOptions = SolverOptions()) -> str:
    """MuJoCo XML of an arm, base at the origin, straight along z.

    Joint order per quaternion joint: lower x, lower y, (slide,) upper y, upper x. Actuators are the strands, in the
    order of `strand_lengths`; a control is a strand's rest length [m]. The site `tip` is the pose's frame.
    """
    root = ElementTree.Element("mujoco", model=arm.name)
    _add_settings(root, arm, options)
    _add_bodies(root, arm, options)
    _add_tendons(root, arm)
    _add_equalities(root, arm, options)
    _add_actuators(root, arm)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def joint_labels(arm: QuaternionArm) -> list[str]:
    """Labels "segment_joint" from the base, both counted from 1; every element's name ends in one."""
    return [f"{k + 1}_{j + 1}" for k, count in enumerate(arm.joints_per_segment) for j in range(count)]


def fit_height_polynomial(arm: QuaternionArm) -> np.ndarray:
    """Quartic (5,) that gives the slide H(theta) - H(0) from the measuring tendon's length change, lowest order first.

    Raises:
        ConfigError: the height changes too sharply near home for a quartic, pins nearly as far apart as the links are long.
    """
    joint = arm.config.joint
    angles = np.linspace(0.0, math.radians(min(joint.bend_limit_deg + joint.stop_margin_deg + 3.0, 95.0)), 400)
    measured = 2.0 * MEASURING_ARM * (np.cos(angles / 4.0) - 1.0)
    shape = (joint.crossed_link_length, joint.pin_distance, joint.plate_to_pin)
    slide = height_of_cosine(*shape, np.cos(angles / 2.0)) - height_of_cosine(*shape, 1.0)
    scale = np.abs(measured).max()
    powers = (measured[:, None] / scale) ** np.arange(1, 5)
    coefficients, *_ = np.linalg.lstsq(powers, slide, rcond=None)
    if np.abs(powers @ coefficients - slide).max() > LARGEST_FIT_ERROR:
        raise ConfigError(
            f"robot.joint.pin_distance: got {joint.pin_distance}, allowed: up to about 0.85 crossed_link_length = "
            f"{0.85 * joint.crossed_link_length:.4g}; beyond, the height changes too sharply for the physics"
        )
    return np.concatenate([[0.0], coefficients / scale ** np.arange(1, 5)])


def _add_settings(root: ElementTree.Element, arm: QuaternionArm, options: SolverOptions) -> None:
    _add(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="auto")
    option = _add(
        root,
        "option",
        timestep=options.timestep,
        integrator="implicitfast",
        solver="Newton",
        iterations=options.solver_iterations,
        tolerance=1e-10,
        jacobian="dense",
        gravity=arm.config.mechanics.gravity,
    )
    _add(option, "flag", contact="disable")
    _add(_add(root, "visual"), "headlight", ambient="0.4 0.4 0.4", diffuse="0.7 0.7 0.7")


def _add_bodies(root: ElementTree.Element, arm: QuaternionArm, options: SolverOptions) -> None:
    """Nested chord and link bodies, with the strands' holes and the measuring sites."""
    world = _add(root, "worldbody")
    mechanics, joint = arm.config.mechanics, arm.config.joint
    home_height = height_of_cosine(joint.crossed_link_length, joint.pin_distance, joint.plate_to_pin, 1.0)
    hinge = dict(
        type="hinge",
        stiffness=2.0 * mechanics.joint_stiffness,  # two hinge pairs of half angles carry 1/2 K theta^2 together
        damping=2.0 * mechanics.joint_damping * options.damping_scale,
        frictionloss=mechanics.joint_friction,
        armature=mechanics.armature * options.armature_scale,
        **_STICKING,
    )
    parent, plate_height = world, 0.0
    for label in joint_labels(arm):
        segment = int(label.split("_")[0]) - 1
        _add_holes(parent, arm, f"lower_{label}", segment, plate_height)
        _add(parent, "site", name=f"measure_lower_{label}", pos=(0.0, 0.0, plate_height - MEASURING_ARM), **_HIDDEN)
        chord = _add(parent, "body", name=f"chord_{label}", pos=(0.0, 0.0, plate_height))
        _add(chord, "joint", name=f"lower_x_{label}", axis="1 0 0", **hinge)
        _add(chord, "joint", name=f"lower_y_{label}", axis="0 1 0", **hinge)
        _add(
            chord,
            "geom",
            type="capsule",
            mass=mechanics.joint_mass,
            size=(0.3 * mechanics.link_radius,),
            fromto=(0, 0, 0, 0, 0, home_height),
            rgba="0.75 0.6 0.3 1",
        )
        _add(chord, "site", name=f"measure_upper_{label}", pos=(0.0, 0.0, MEASURING_ARM), **_HIDDEN)
        link = _add(chord, "body", name=f"link_{label}", pos=(0.0, 0.0, home_height))
        if arm.joint_model == "rolling":
            _add(link, "joint", name=f"slide_{label}", type="slide", axis="0 0 1", armature=SLIDE_ARMATURE)
        _add(link, "joint", name=f"upper_y_{label}", axis="0 1 0", **hinge)
        _add(link, "joint", name=f"upper_x_{label}", axis="1 0 0", **hinge)
        length = arm.config.link_length
        half = max(length / 2.0, 0.001)
        _add(
            link,
            "geom",
            type="cylinder",
            mass=mechanics.link_mass,
            size=(mechanics.link_radius, half),
            pos=(0.0, 0.0, length / 2.0),
            rgba="0.3 0.35 0.45 0.6",
        )
        _add_holes(link, arm, f"upper_{label}", segment, 0.0)
        parent, plate_height = link, length
    _add(parent, "site", name="tip", pos=(0.0, 0.0, plate_height), size=(0.006,), rgba="0.9 0.2 0.2 1")
    if mechanics.payload > 0.0:
        _add(
            parent,
            "geom",
            name="payload",
            type="sphere",
            mass=mechanics.payload,
            size=(0.01,),
            pos=(0.0, 0.0, plate_height),
            rgba="0.9 0.5 0.1 1",
        )


def _add_holes(body: ElementTree.Element, arm: QuaternionArm, label: str, segment: int, height: float) -> None:
    """Sites of the strands that cross a joint of `segment`: those of this and of every later segment."""
    radius = arm.config.cables.hole_circle_diameter / 2.0
    for strand in range(4 * segment, arm.num_strands):
        angle = _strand_angle(arm, strand)
        position = (radius * math.cos(angle), radius * math.sin(angle), height)
        _add(body, "site", name=f"hole_{label}_{strand}", pos=position, **_HIDDEN)


def _add_tendons(root: ElementTree.Element, arm: QuaternionArm) -> None:
    """Strands through the plate holes (pulleys leave out the constant runs inside links), and measuring tendons."""
    tendon = _add(root, "tendon")
    strands = arm.config.strands
    for strand in range(arm.num_strands):
        spatial = _add(
            tendon,
            "spatial",
            name=strand_name(arm, strand),
            damping=strands.damping,
            frictionloss=strands.friction,
            width=0.0006,
            rgba="0.8 0.2 0.2 1",
            **_STICKING,
        )
        crossed = [label for label in joint_labels(arm) if int(label.split("_")[0]) - 1 <= strand // 4]
        for index, label in enumerate(crossed):
            if index:
                _add(spatial, "pulley", divisor=1)
            _add(spatial, "site", site=f"hole_lower_{label}_{strand}")
            _add(spatial, "site", site=f"hole_upper_{label}_{strand}")
    for label in joint_labels(arm):
        _add_measuring_tendons(tendon, arm, label)


def _add_measuring_tendons(tendon: ElementTree.Element, arm: QuaternionArm, label: str) -> None:
    """Length 2 c cos(theta/4): ties the slide, and its lower limit is the mechanical stop on theta."""
    is_first = label.endswith("_1")
    if not is_first and arm.joint_model == "spherical":
        return  # the coupling passes the first joint's stop on
    joint = arm.config.joint
    stop = math.radians(joint.bend_limit_deg + joint.stop_margin_deg)
    limit = dict(
        range=(2.0 * MEASURING_ARM * math.cos(stop / 4.0), 3.0 * MEASURING_ARM),
        solreflimit="0.008 1",
        solimplimit=HARD_SOLIMP,
    )
    measure = _add(tendon, "spatial", name=f"measure_{label}", rgba="0 0 0 0", **(limit if is_first else {}))
    _add(measure, "site", site=f"measure_lower_{label}")
    _add(measure, "site", site=f"measure_upper_{label}")
    if arm.joint_model == "rolling":
        fixed = _add(tendon, "fixed", name=f"height_{label}")
        _add(fixed, "joint", joint=f"slide_{label}", coef=1)


def _add_equalities(root: ElementTree.Element, arm: QuaternionArm, options: SolverOptions) -> None:
    """Equal halves of a joint, equal joints of a segment, and the height of the rolling joint."""
    equality = _add(root, "equality")
    hard = dict(solref=(options.equality_time_constant, 1.0), solimp=HARD_SOLIMP)
    for label in joint_labels(arm):
        first = label.split("_")[0] + "_1"
        for axis in "xy":
            _add(equality, "joint", joint1=f"upper_{axis}_{label}", joint2=f"lower_{axis}_{label}", **hard)
            if label != first:
                _add(equality, "joint", joint1=f"lower_{axis}_{label}", joint2=f"lower_{axis}_{first}", **hard)
        if arm.joint_model == "rolling":
            _add(
                equality,
                "tendon",
                tendon1=f"height_{label}",
                tendon2=f"measure_{label}",
                polycoef=fit_height_polynomial(arm),
                **hard,
            )


def _add_actuators(root: ElementTree.Element, arm: QuaternionArm) -> None:
    """A position servo per strand, stiffness EA/L, which pulls up to the strand's strength and never pushes."""
    actuator = _add(root, "actuator")
    for strand in range(arm.num_strands):
        name = strand_name(arm, strand)
        _add(
            actuator,
            "position",
            name=name,
            tendon=name,
            kp=float(arm.strand_stiffness),
            forcerange=(-arm.config.strands.strength, 0.0),
        )


def strand_name(arm: QuaternionArm, strand: int) -> str:
    """ "strand_NUMBER_a" at the cable's hole angle, "strand_NUMBER_b" opposite to it."""
    numbers = [number for pair in arm.config.cables.names for number in pair]
    return f"strand_{numbers[strand // 2]}_{'ab'[strand % 2]}"


def _strand_angle(arm: QuaternionArm, strand: int) -> float:
    angles = [angle for pair in arm.config.cables.hole_angles_deg for angle in pair]
    return math.radians(angles[strand // 2] + 180.0 * (strand % 2))


def _add(parent: ElementTree.Element, tag: str, **attributes) -> ElementTree.Element:
    """Child element; floats are written with repr, so that compiled lengths are exact."""
    return ElementTree.SubElement(parent, tag, {key: _text(value) for key, value in attributes.items()})


def _text(value) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, bool | int):
        return str(value).lower()
    if isinstance(value, float | np.floating):
        return repr(float(value))
    return " ".join(_text(item) for item in value)


_HIDDEN = dict(size="0.001", group="4")
# MuJoCo's default friction rows creep; these stick (measured: path dependence of the tip stays after the motion ends).
_STICKING = dict(solreffriction="0.008 1", solimpfriction="0.9999 0.9999 0.001 0.5 2")
