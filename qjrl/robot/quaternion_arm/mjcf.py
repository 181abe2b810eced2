"""MJCF of the arm: hinges on half angles, one slide for the rolling joint's height, pull-only strand pairs.

One joint is two half-angle universal joints: hinges x, y -- chord -- hinges y, x with equal halves. By mirror symmetry
that is exactly the joint of Eq. 2, and cos(theta/2) = cos x cos y. The rolling joint adds one slide along the chord,
tied to theta. Compliance enters as named physical values only (joint stiffness, strand stiffness): every other force
comes from hard rows, which `mjcf_ties` writes.
"""

import math
from xml.etree import ElementTree

from qjrl.robot.mjcf_text import add_element
from qjrl.robot.plant import PAYLOAD_RADIUS
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.mjcf_ties import (
    HIDDEN_SITE,
    add_equalities,
    add_measuring_sites,
    add_stops_and_heights,
    height_at_home,
    straight_length,
)
from qjrl.robot.quaternion_arm.naming import joint_labels, leader, segment_of, strand_name
from qjrl.robot.solver_options import SolverOptions

# Inertia of the slide [kg]. A height row is soft in proportion to its inverse: at 1 kg the tip rests 0.03 mm below the
# minimum of the potential energy, at 10 kg 0.005 mm. Small against the hinges' while dH/dtheta stays below 5 mm/rad.
SLIDE_ARMATURE = 10.0
# Radius of a joint's limbs, taken together, relative to the link's.
CHORD_RADIUS = 0.3
# MuJoCo's default friction rows creep; these stick (measured: path dependence of the tip stays after the motion ends).
STICKING = {"solreffriction": "0.008 1", "solimpfriction": "0.9999 0.9999 0.001 0.5 2"}


def build_mjcf(arm: QuaternionArm, options: SolverOptions = SolverOptions()) -> str:
    """MuJoCo XML of an arm, base at the origin, straight along z.

    Joint order per quaternion joint: lower x, lower y, (slide,) upper y, upper x. Tendons begin with the strands, in the
    order of `strand_lengths`; actuators are the strands, a control is a strand's rest length [m]. The site `tip` is the
    pose's frame.

    Raises:
        ConfigError: the rolling joint's height cannot be represented (pins nearly as far apart as the links are long).
    """
    root = ElementTree.Element("mujoco", model=arm.name)
    _add_settings(root, arm, options)
    _add_bodies(root, arm, options)
    tendon = add_element(root, "tendon")
    _add_strands(tendon, arm, options)
    add_stops_and_heights(tendon, arm, options.lumping)
    add_equalities(root, arm, options.equality_time_constant, options.lumping)
    _add_actuators(root, arm)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _add_settings(root: ElementTree.Element, arm: QuaternionArm, options: SolverOptions) -> None:
    add_element(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="auto")
    option = add_element(
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
    add_element(option, "flag", contact="disable")
    length = straight_length(arm)
    add_element(root, "statistic", extent=length, center=(0.0, 0.0, 0.5 * length))  # without the far sites of the stops
    visual = add_element(root, "visual")
    add_element(visual, "headlight", ambient="0.4 0.4 0.4", diffuse="0.7 0.7 0.7")


def _add_bodies(root: ElementTree.Element, arm: QuaternionArm, options: SolverOptions) -> None:
    """Nested chords and links from the base to the tip."""
    parent, plate_height = add_element(root, "worldbody"), 0.0
    for label in joint_labels(arm):
        chord, link = _add_joint(parent, arm, options, label, plate_height)
        add_measuring_sites(parent, chord, link, label, plate_height, height_at_home(arm.config.joint))
        _add_link(link, arm)
        if label == leader(label, options.lumping):
            _add_holes(parent, arm, f"lower_{label}", segment_of(label), plate_height)
            _add_holes(link, arm, f"upper_{label}", segment_of(label), 0.0)
        parent, plate_height = link, arm.config.link_length
    tip = (0.0, 0.0, plate_height)
    add_element(parent, "site", name="tip", pos=tip, size=(0.006,), rgba="0.9 0.2 0.2 1")
    payload = arm.config.mechanics.payload
    if payload > 0.0:
        look = {"size": (PAYLOAD_RADIUS,), "rgba": "0.9 0.5 0.1 1"}
        add_element(parent, "geom", name="payload", type="sphere", mass=payload, pos=tip, **look)


def _add_joint(
    parent: ElementTree.Element, arm: QuaternionArm, options: SolverOptions, label: str, plate_height: float
) -> tuple[ElementTree.Element, ElementTree.Element]:
    """The chord body, on the lower pair of hinges, and the link body, on the slide and the upper pair."""
    mechanics, home_height = arm.config.mechanics, height_at_home(arm.config.joint)
    hinge = {
        "type": "hinge",
        "stiffness": 2.0 * mechanics.joint_stiffness,  # two hinge pairs of half angles carry 1/2 K theta^2 together
        "damping": 2.0 * mechanics.joint_damping * options.damping_scale,
        "frictionloss": mechanics.joint_friction,
        "armature": mechanics.armature * options.armature_scale,
        **STICKING,
    }
    chord = add_element(parent, "body", name=f"chord_{label}", pos=(0.0, 0.0, plate_height))
    add_element(chord, "joint", name=f"lower_x_{label}", axis="1 0 0", **hinge)
    add_element(chord, "joint", name=f"lower_y_{label}", axis="0 1 0", **hinge)
    look = {"size": (CHORD_RADIUS * mechanics.link_radius,), "rgba": "0.75 0.6 0.3 1"}
    along = (0.0, 0.0, 0.0, 0.0, 0.0, home_height)
    add_element(chord, "geom", type="capsule", mass=mechanics.joint_mass, fromto=along, **look)
    link = add_element(chord, "body", name=f"link_{label}", pos=(0.0, 0.0, home_height))
    if arm.joint_model == "rolling":
        slide = SLIDE_ARMATURE * options.armature_scale
        add_element(link, "joint", name=f"slide_{label}", type="slide", axis="0 0 1", armature=slide)
    add_element(link, "joint", name=f"upper_y_{label}", axis="0 1 0", **hinge)
    add_element(link, "joint", name=f"upper_x_{label}", axis="1 0 0", **hinge)
    return chord, link


def _add_link(link: ElementTree.Element, arm: QuaternionArm) -> None:
    """The link with its two plates: a solid cylinder."""
    mechanics, length = arm.config.mechanics, arm.config.link_length
    size = (mechanics.link_radius, max(length / 2.0, 0.001))
    look = {"pos": (0.0, 0.0, length / 2.0), "rgba": "0.3 0.35 0.45 0.6"}
    add_element(link, "geom", type="cylinder", mass=mechanics.link_mass, size=size, **look)


def _add_holes(body: ElementTree.Element, arm: QuaternionArm, label: str, segment: int, height: float) -> None:
    """Sites of the strands that cross a joint of `segment`: those of this and of every later segment."""
    radius = arm.config.cables.hole_circle_diameter / 2.0
    angles = [angle for pair in arm.config.cables.hole_angles_deg for angle in pair]
    for strand in range(4 * segment, arm.num_strands):
        angle = math.radians(angles[strand // 2] + 180.0 * (strand % 2))
        position = (radius * math.cos(angle), radius * math.sin(angle), height)
        add_element(body, "site", name=f"hole_{label}_{strand}", pos=position, **HIDDEN_SITE)


def _add_strands(tendon: ElementTree.Element, arm: QuaternionArm, options: SolverOptions) -> None:
    """Strands through the plate holes. Pulleys leave out the constant runs inside links, and count a crossing once for each
    joint it stands for."""
    strands = arm.config.strands
    force = {"damping": strands.damping * options.strand_damping_scale, "frictionloss": strands.friction, **STICKING}
    look = {"width": 0.0006, "rgba": "0.8 0.2 0.2 1"}
    for strand in range(arm.num_strands):
        spatial = add_element(tendon, "spatial", name=strand_name(arm, strand), **force, **look)
        for label in joint_labels(arm):
            if segment_of(label) > strand // 4 or label != leader(label, options.lumping):
                continue
            led = sum(leader(other, options.lumping) == label for other in joint_labels(arm))
            add_element(spatial, "pulley", divisor=1.0 / led)
            add_element(spatial, "site", site=f"hole_lower_{label}_{strand}")
            add_element(spatial, "site", site=f"hole_upper_{label}_{strand}")


def _add_actuators(root: ElementTree.Element, arm: QuaternionArm) -> None:
    """A position servo per strand, stiffness EA/L, which pulls up to the strand's strength and never pushes."""
    actuator = add_element(root, "actuator")
    servo = {"kp": float(arm.strand_stiffness), "forcerange": (-arm.config.strands.strength, 0.0)}
    for strand in range(arm.num_strands):
        name = strand_name(arm, strand)
        add_element(actuator, "position", name=name, tendon=name, **servo)
