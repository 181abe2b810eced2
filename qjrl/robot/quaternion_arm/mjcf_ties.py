"""What ties the arm's hinges and slides: equal halves, equal joints of a segment, the rolling height, the stop.

Two lengths are measured by tendons at every joint. `measure`: from c below the lower pivot to c along the chord,
2 c cos(theta/4), where c is the joint's height at home: it depends on theta alone, and a quartic of it gives the slide.
`stop`, at the first joint of a segment, is the same length with a lower bound, so that the limit acts on theta whatever the
direction.
"""

import math
from xml.etree import ElementTree

import numpy as np

from qjrl.config import ConfigError
from qjrl.robot.mjcf_text import add_element
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.description import JointConfig
from qjrl.robot.quaternion_arm.joint import height_of_cosine
from qjrl.robot.quaternion_arm.naming import first_of_segment, joint_labels, leader

# All lengths here are relative to the arm's, so that an arm in another size has the same model in that size.
# Nearly rigid rows. With MuJoCo's default impedance the tip rests 6 mm off and moves with armature and solref.
HARD_SOLIMP = "0.9999 0.9999 0.001 0.5 2"
# The slide follows the closed form this closely, relative to the crossed links; 2e-7 for the default arm.
LARGEST_FIT_ERROR = 4e-5
# MuJoCo makes a row as soft as its inverse inertia *at home*, where `measure` does not change to first order: a limit on
# it alone is infinitely hard and chatters (theta up to 80 degrees at a stop of 72, for ever). So `stop` adds two strings
# that run sideways from far points of the chord to the axes of the two plates: what one pays out the other takes in, as
# the halves are equal, and only the inverse inertia at home sees them. FAR, in heights of a joint, makes them straight.
# SOFTNESS is how much of their length counts, relative to how fast `measure` changes at the stop: with 0.8 the stop gives
# way by 0.3 degrees under the full strength of all strands, and rests; with 0.5 some poses chatter.
FAR = 1000.0
SOFTNESS = 0.8
HIDDEN_SITE = {"size": "0.001", "group": "4"}


def height_at_home(joint: JointConfig) -> float:
    """Distance of a joint's two plates at home [m]."""
    return height_of_cosine(joint.crossed_link_length, joint.pin_distance, joint.plate_to_pin, 1.0)


def straight_length(arm: QuaternionArm) -> float:
    """From the base to the tip of the straight arm [m]."""
    return arm.num_joints * (height_at_home(arm.config.joint) + arm.config.link_length)


def add_measuring_sites(
    parent: ElementTree.Element,
    chord: ElementTree.Element,
    link: ElementTree.Element,
    label: str,
    plate_height: float,
    home_height: float,
) -> None:
    """Sites of the tendons `measure` and `stop` of one joint."""
    c, far = home_height, FAR * home_height
    add_element(parent, "site", name=f"below_{label}", pos=(0.0, 0.0, plate_height - c), **HIDDEN_SITE)
    add_element(chord, "site", name=f"along_{label}", pos=(0.0, 0.0, c), **HIDDEN_SITE)
    if label == first_of_segment(label):
        add_element(chord, "site", name=f"far_below_{label}", pos=(-far, 0.0, -c), **HIDDEN_SITE)
        add_element(chord, "site", name=f"far_above_{label}", pos=(far, 0.0, home_height + c), **HIDDEN_SITE)
        add_element(link, "site", name=f"above_{label}", pos=(0.0, 0.0, c), **HIDDEN_SITE)


def add_stops_and_heights(tendon: ElementTree.Element, arm: QuaternionArm, lumping: int) -> None:
    """The stop of every segment's first joint, whose coupling passes it on, and what ties the slides of rolling joints."""
    for label in joint_labels(arm):
        if label == first_of_segment(label):
            _add_stop(tendon, arm, label)
        if arm.joint_model == "rolling" and label == leader(label, lumping):
            _add_path(tendon, f"measure_{label}", [(f"below_{label}", f"along_{label}", 1.0)])
            fixed = add_element(tendon, "fixed", name=f"height_{label}")
            add_element(fixed, "joint", joint=f"slide_{label}", coef=1)


def add_equalities(root: ElementTree.Element, arm: QuaternionArm, time_constant: float, lumping: int) -> None:
    """Equal halves of a joint, equal joints of a segment, and the height of the rolling joint."""
    equality = add_element(root, "equality")
    hard = {"solref": (time_constant, 1.0), "solimp": HARD_SOLIMP}
    polynomial = fit_height_polynomial(arm) if arm.joint_model == "rolling" else None
    for label in joint_labels(arm):
        first = first_of_segment(label)
        for axis in "xy":
            lower = f"lower_{axis}_{label}"
            add_element(equality, "joint", joint1=f"upper_{axis}_{label}", joint2=lower, **hard)
            if label != first:
                add_element(equality, "joint", joint1=lower, joint2=f"lower_{axis}_{first}", **hard)
        if polynomial is not None and label != leader(label, lumping):
            add_element(equality, "joint", joint1=f"slide_{label}", joint2=f"slide_{leader(label, lumping)}", **hard)
        elif polynomial is not None:
            tied = {"tendon1": f"height_{label}", "tendon2": f"measure_{label}", "polycoef": polynomial}
            add_element(equality, "tendon", **tied, **hard)


def fit_height_polynomial(arm: QuaternionArm) -> np.ndarray:
    """Quartic (5,) that gives the slide H(theta) - H(0) from the length change of `measure`, lowest order first.

    Raises:
        ConfigError: the height changes too sharply near home for a quartic, pins nearly as far apart as the links are long.
    """
    joint = arm.config.joint
    coefficients, error = _fit_heights(joint, joint.pin_distance)
    if error > LARGEST_FIT_ERROR:
        raise ConfigError(
            f"robot.joint.pin_distance: got {joint.pin_distance}, allowed: up to about {_largest_pin_distance(joint):.3g} with "
            f"these links and this bend limit; beyond, the height changes too sharply for the physics"
        )
    return coefficients


def _fit_heights(joint: JointConfig, pin_distance: float) -> tuple[np.ndarray, float]:
    """The quartic of a joint with its pins so far apart, and its largest error relative to the crossed links."""
    angles = np.linspace(0.0, math.radians(min(joint.bend_limit_deg + joint.stop_margin_deg + 3.0, 95.0)), 400)
    measured = 2.0 * height_at_home(joint) * (np.cos(angles / 4.0) - 1.0)
    shape = (joint.crossed_link_length, pin_distance, joint.plate_to_pin)
    slide = height_of_cosine(*shape, np.cos(angles / 2.0)) - height_of_cosine(*shape, 1.0)
    scale = np.abs(measured).max()
    powers = (measured[:, None] / scale) ** np.arange(1, 5)
    coefficients, *_ = np.linalg.lstsq(powers, slide, rcond=None)
    error = float(np.abs(powers @ coefficients - slide).max()) / joint.crossed_link_length
    return np.concatenate([[0.0], coefficients / scale ** np.arange(1, 5)]), error


def _largest_pin_distance(joint: JointConfig) -> float:
    """That the quartic can follow [m]; its error grows with the pins' distance."""
    low, high = 0.0, joint.pin_distance
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _fit_heights(joint, middle)[1] <= LARGEST_FIT_ERROR else (low, middle)
    return low


def _add_stop(tendon: ElementTree.Element, arm: QuaternionArm, label: str) -> None:
    joint = arm.config.joint
    stop = math.radians(joint.bend_limit_deg + joint.stop_margin_deg)
    share = SOFTNESS * math.sin(stop / 4.0)
    height = height_at_home(joint)
    strings = 2.0 * FAR * height * share
    limit = {
        "range": (strings + 2.0 * height * math.cos(stop / 4.0), 2.0 * strings),
        "solreflimit": "0.008 1",
        "solimplimit": HARD_SOLIMP,
    }
    branches = [
        (f"below_{label}", f"along_{label}", 1.0),
        (f"far_below_{label}", f"below_{label}", share),
        (f"far_above_{label}", f"above_{label}", share),
    ]
    _add_path(tendon, f"stop_{label}", branches, **limit)


def _add_path(tendon: ElementTree.Element, name: str, branches: list[tuple[str, str, float]], **attributes) -> None:
    """A hidden spatial tendon: the sum of straight branches between two sites, each times its share."""
    spatial = add_element(tendon, "spatial", name=name, rgba="0 0 0 0", **attributes)
    for start, end, share in branches:
        if share != 1.0:
            add_element(spatial, "pulley", divisor=1.0 / share)
        add_element(spatial, "site", site=start)
        add_element(spatial, "site", site=end)
