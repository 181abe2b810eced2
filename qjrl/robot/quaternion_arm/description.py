"""What a quaternion-joint arm is: the values of its YAML, checked, and the pytree that the kinematics read."""

import math
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.config import ConfigError, Range, configuration
from qjrl.field_words import show
from qjrl.robot.kind import Robot
from qjrl.robot.quaternion_arm.dimensions import check_dimensions
from qjrl.robot.unit_hints import length_hint

Positive = Range(above=0.0)
NonNegative = Range(low=0.0)
Number = Annotated[int, Range(low=0)]
LONGEST_NAME = 100
"""Letters; reports and file formats carry it."""


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
        if not (self.name.strip() and self.name.isprintable() and len(self.name) <= LONGEST_NAME):
            raise ValueError(f"name: got {show(self.name)}, allowed: a text on one line, up to {LONGEST_NAME} letters")
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


@struct.dataclass
class QuaternionArm(Robot):
    """An arm as a pytree: lengths, angles and stiffnesses are traced leaves, counts and joint model static."""

    crossed_link_length: jax.Array
    """l [m]."""
    pin_distance: jax.Array
    """k [m]."""
    plate_to_pin: jax.Array
    """d [m]."""
    link_length: jax.Array
    """l0 [m]."""
    hole_circle_diameter: jax.Array
    """D [m]."""
    hole_angles: jax.Array
    """(num_segments, 2) [rad]."""
    bend_limit: jax.Array
    """Largest commanded theta [rad]."""
    strand_stiffness: jax.Array
    """Of strand and tensioner in series [N/m]."""
    pretension: jax.Array
    """[N]."""
    motor_speed: jax.Array
    """[m/s]."""
    motor_force: jax.Array
    """[N]."""
    config: QuaternionArmConfig = struct.field(pytree_node=False)
    """The values as described; what only the physics needs is read from here."""
    joints_per_segment: tuple[int, ...] = struct.field(pytree_node=False)
    joint_model: str = struct.field(pytree_node=False)
    """"spherical" (constant height) or "rolling"."""

    kind = "quaternion_arm"

    @property
    def name(self) -> str:
        return self.config.name

    @property
    def strand_friction(self) -> float:
        return self.config.strands.friction

    @property
    def payload(self) -> float:
        return self.config.mechanics.payload

    @property
    def num_segments(self) -> int:
        return len(self.joints_per_segment)

    @property
    def num_joints(self) -> int:
        return sum(self.joints_per_segment)

    @property
    def num_positions(self) -> int:
        """Joint positions of the MJCF: four half angles a joint, and a slide where it rolls."""
        return self.num_joints * (5 if self.joint_model == "rolling" else 4)

    @property
    def num_cables(self) -> int:
        return 2 * self.num_segments

    @property
    def num_strands(self) -> int:
        return 4 * self.num_segments


def arm_from_config(config: QuaternionArmConfig) -> QuaternionArm:
    """The pytree of a checked description.

    Raises:
        ValueError: its values contradict each other.
    """
    check_dimensions(config)
    joint, strands = config.joint, config.strands
    compliance = 1.0 / strands.stiffness + (1.0 / strands.tensioner_stiffness if strands.tensioner_stiffness else 0.0)
    is_spherical = joint.pin_distance == 0.0 and joint.plate_to_pin == 0.0
    return QuaternionArm(
        crossed_link_length=jnp.asarray(joint.crossed_link_length),
        pin_distance=jnp.asarray(joint.pin_distance),
        plate_to_pin=jnp.asarray(joint.plate_to_pin),
        link_length=jnp.asarray(config.link_length),
        hole_circle_diameter=jnp.asarray(config.cables.hole_circle_diameter),
        hole_angles=jnp.radians(jnp.asarray(config.cables.hole_angles_deg)),
        bend_limit=jnp.asarray(math.radians(joint.bend_limit_deg)),
        strand_stiffness=jnp.asarray(1.0 / compliance),
        pretension=jnp.asarray(strands.pretension),
        motor_speed=jnp.asarray(config.motors.speed),
        motor_force=jnp.asarray(config.motors.force),
        config=config,
        joints_per_segment=config.joints_per_segment,
        joint_model="spherical" if is_spherical else "rolling",
    )


def require_arm(robot: Any, who: str) -> QuaternionArm:
    """The robot, if it is a quaternion-joint arm.

    Args:
        who: what works for this kind alone, for the message.
    Raises:
        ConfigError: it is of another kind.
    """
    if not isinstance(robot, QuaternionArm):
        kind = f"a robot of kind {robot.kind}" if isinstance(robot, Robot) else show(robot)
        raise ConfigError(f"{who}: got {kind}, allowed: a robot of kind quaternion_arm")
    return robot
