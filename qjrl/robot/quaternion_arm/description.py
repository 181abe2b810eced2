"""What describes a quaternion-joint arm: the values of its YAML, checked."""

import math
from typing import Annotated, Literal

from qjrl.config import Range, configuration
from qjrl.robot.descriptions import NonNegative, Number, Positive, check_name
from qjrl.robot.unit_hints import length_hint


@configuration
class JointConfig:
    """One quaternion joint: a crossed four-bar (antiparallelogram) between two plates."""

    crossed_link_length: Annotated[float, Positive]
    """Length l of the crossed links [m]."""
    pin_distance: Annotated[float, NonNegative]
    """Distance k of the two pins on a plate [m]; with plate_to_pin = 0 as well, k = 0 is the spherical joint."""
    plate_to_pin: Annotated[float, NonNegative]
    """Offset d of the pins from their plate [m]."""
    bend_limit_deg: Annotated[float, Range(above=0.0, below=90.0)]
    """Largest commanded bend angle of a joint [deg]."""
    stop_margin_deg: Annotated[float, Range(low=0.0, high=20.0)]
    """How far beyond the limit the mechanical stop lies [deg]."""

    def __post_init__(self):
        if self.pin_distance >= self.crossed_link_length:
            raise ValueError(
                f"pin_distance: got {self.pin_distance}, allowed: less than crossed_link_length = {self.crossed_link_length}"
                f"{_hint_where_far(self.pin_distance / self.crossed_link_length)}"
            )


@configuration
class CablesConfig:
    """Routing: one cable is a loop of two strands through opposite holes, driven by one motor."""

    hole_circle_diameter: Annotated[float, Positive]
    """Diameter D of the circle of holes in every plate [m]."""
    hole_angles_deg: tuple[tuple[float, float], ...]
    """Hole angle of the two cables of each segment [deg]; the return strand runs at +180."""
    names: tuple[tuple[Number, Number], ...]
    """The number each cable goes by on the machine, per segment."""


@configuration
class MechanicsConfig:
    """Masses and passive forces; no field here is a solver setting."""

    joint_mass: Annotated[float, Positive]
    """Limbs of one joint [kg]."""
    link_mass: Annotated[float, Positive]
    """Link with its two plates [kg]."""
    link_radius: Annotated[float, Positive]
    """Radius of the link, a solid cylinder for the inertia [m]."""
    joint_stiffness: Annotated[float, NonNegative]
    """Restoring torque against the bend angle of a joint [N m/rad]."""
    joint_damping: Annotated[float, NonNegative]
    """Viscous torque against the bend rate of a joint [N m s/rad]."""
    joint_friction: Annotated[float, NonNegative]
    """Dry friction of each half-angle hinge [N m]."""
    armature: Annotated[float, Positive]
    """Inertia added to each hinge [kg m^2]."""
    gravity: tuple[float, float, float]
    """Gravity in the base frame, whose z is the straight arm [m/s^2]."""
    payload: Annotated[float, NonNegative]
    """Mass at the tip [kg]."""


@configuration
class StrandsConfig:
    """A strand pulls and never pushes."""

    stiffness: Annotated[float, Positive]
    """EA/L of a strand [N/m]."""
    tensioner_stiffness: Annotated[float, Positive] | None
    """Spring in series with every strand [N/m]; null for none."""
    damping: Annotated[float, NonNegative]
    """Viscous force along a strand [N s/m]."""
    friction: Annotated[float, NonNegative]
    """Dry friction along a strand [N]."""
    pretension: Annotated[float, NonNegative]
    """Tension of every strand at home [N]."""
    strength: Annotated[float, Positive]
    """Largest tension of a strand [N]."""


@configuration
class MotorsConfig:
    """One motor a cable."""

    speed: Annotated[float, Positive]
    """Largest cable speed [m/s]."""
    force: Annotated[float, Positive]
    """Largest difference of the tensions of a loop's two strands [N]."""
    pulley_radius: Annotated[float, Positive]
    """[m]."""


@configuration
class QuaternionArmConfig:
    """The YAML of an arm (`kind: quaternion_arm`, `schema: 1`)."""

    kind: Literal["quaternion_arm"]
    schema: Literal[1]
    name: str
    joints_per_segment: tuple[Annotated[int, Range(low=1, high=6)], ...]
    """m_k for each segment, from the base."""
    joint: JointConfig
    link_length: Annotated[float, NonNegative]
    """Length l0 of the link after every joint [m]."""
    cables: CablesConfig
    mechanics: MechanicsConfig
    strands: StrandsConfig
    motors: MotorsConfig

    def __post_init__(self):
        check_name(self.name)
        num_segments = len(self.joints_per_segment)
        if num_segments == 0:
            raise ValueError("joints_per_segment: got [], allowed: at least one segment")
        for key in ("hole_angles_deg", "names"):
            if len(getattr(self.cables, key)) != num_segments:
                raise ValueError(
                    f"cables.{key}: got {len(getattr(self.cables, key))} pairs, allowed: one for each of the {num_segments} segments"
                )
        names = [name for pair in self.cables.names for name in pair]
        if len(set(names)) != len(names):
            raise ValueError(f"cables.names: got {names}, allowed: all different")
        _check_hole_angles(self.cables)
        _check_stop(self.joint, self.cables.hole_circle_diameter)


def _check_stop(joint: JointConfig, hole_circle_diameter: float) -> None:
    """Up to the mechanical stop the plates of a joint stay apart: there the strand on the inside is the shortest."""
    stop = joint.bend_limit_deg + joint.stop_margin_deg
    if stop >= 90.0:
        raise ValueError(
            f"joint.stop_margin_deg: got {joint.stop_margin_deg}, allowed: bend_limit_deg + stop_margin_deg below 90"
        )
    cosine, sine = math.cos(math.radians(stop) / 2.0), math.sin(math.radians(stop) / 2.0)
    height = (
        math.sqrt(joint.crossed_link_length**2 - (joint.pin_distance * cosine) ** 2) + 2.0 * joint.plate_to_pin * cosine
    )
    if hole_circle_diameter * sine >= height:
        raise ValueError(
            f"cables.hole_circle_diameter: got {hole_circle_diameter}, allowed: less than {height / sine:.4g}, "
            f"where the plates of a joint touch at its stop of {stop:.12g} deg"
            f"{_hint_where_far(hole_circle_diameter * sine / height)}"
        )


def _hint_where_far(excess: float) -> str:
    """A circle a little too large is no slip of units."""
    return length_hint(excess) if excess > 10.0 else ""


def _check_hole_angles(cables: CablesConfig) -> None:
    """Each hole belongs to one strand: angles differ modulo 180, since return strands use the opposite hole."""
    holes = sorted(
        (angle % 180.0, name, angle)
        for angles, names in zip(cables.hole_angles_deg, cables.names, strict=True)
        for angle, name in zip(angles, names, strict=True)
    )
    turned = [*holes[1:], (holes[0][0] + 180.0, *holes[0][1:])]
    (first, one, at), (second, other, other_at) = min(
        zip(holes, turned, strict=True), key=lambda pair: pair[1][0] - pair[0][0]
    )
    if second - first < 1.0:
        largest = max(abs(angle) for _, _, angle in holes)
        hint = "; in radians? multiply by 57.3" if 0.0 < largest <= 2.0 * math.pi else ""
        raise ValueError(
            f"cables.hole_angles_deg: got {[list(pair) for pair in cables.hole_angles_deg]}, allowed: all different by 1 deg "
            f"or more, modulo 180; the holes of cable {one} at {at:g} and of cable {other} at {other_at:g} collide{hint}"
        )
