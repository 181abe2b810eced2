"""The quaternion-joint arm as a pytree: every number of its description is a traced leaf and stands here alone.

Kinematics, equations of motion, MJCF, limits and hash read the leaves, so that a changed leaf changes all of them. Arms
whose leaves have a leading axis are a batch for `jax.vmap`. As described, a number is a plain one, exact in any precision.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.config import ConfigError, build
from qjrl.field_words import show
from qjrl.robot.kind import Robot
from qjrl.robot.leaves import Number, described, leaves_of
from qjrl.robot.quaternion_arm.description import JointConfig, QuaternionArmConfig
from qjrl.robot.quaternion_arm.dimensions import check_dimensions

# Leaf -> its place in the description.
_PLACES = {
    "crossed_link_length": "joint.crossed_link_length",
    "pin_distance": "joint.pin_distance",
    "plate_to_pin": "joint.plate_to_pin",
    "bend_limit_deg": "joint.bend_limit_deg",
    "stop_margin_deg": "joint.stop_margin_deg",
    "link_length": "link_length",
    "hole_circle_diameter": "cables.hole_circle_diameter",
    "hole_angles_deg": "cables.hole_angles_deg",
    "joint_mass": "mechanics.joint_mass",
    "link_mass": "mechanics.link_mass",
    "link_radius": "mechanics.link_radius",
    "joint_stiffness": "mechanics.joint_stiffness",
    "joint_damping": "mechanics.joint_damping",
    "joint_friction": "mechanics.joint_friction",
    "armature": "mechanics.armature",
    "gravity": "mechanics.gravity",
    "payload": "mechanics.payload",
    "cord_stiffness": "strands.stiffness",
    "tensioner_stiffness": "strands.tensioner_stiffness",
    "strand_damping": "strands.damping",
    "strand_friction": "strands.friction",
    "pretension": "strands.pretension",
    "strand_strength": "strands.strength",
    "motor_speed": "motors.speed",
    "motor_force": "motors.force",
    "pulley_radius": "motors.pulley_radius",
}
_NUM_AXES = {"gravity": 1, "hole_angles_deg": 2}


@struct.dataclass
class QuaternionArm(Robot):
    """Numbers are leaves, counts and the joint's model are static. Meaning and range of each: `description`."""

    crossed_link_length: Number
    """l [m]."""
    pin_distance: Number
    """k [m]."""
    plate_to_pin: Number
    """d [m]."""
    bend_limit_deg: Number
    """Largest commanded theta [deg]."""
    stop_margin_deg: Number
    """From there to the mechanical stop [deg]."""
    link_length: Number
    """l0 [m]."""
    hole_circle_diameter: Number
    """D [m]."""
    hole_angles_deg: Any
    """(num_segments, 2) [deg]."""
    joint_mass: Number
    """[kg]."""
    link_mass: Number
    """[kg]."""
    link_radius: Number
    """[m]."""
    joint_stiffness: Number
    """K [N m/rad]."""
    joint_damping: Number
    """[N m s/rad]."""
    joint_friction: Number
    """[N m]."""
    armature: Number
    """Of a hinge [kg m^2]."""
    gravity: Any
    """(3,) [m/s^2]."""
    payload: Number
    """[kg]."""
    cord_stiffness: Number
    """Of a strand without its tensioner [N/m]."""
    tensioner_stiffness: Number
    """[N/m]."""
    strand_damping: Number
    """[N s/m]."""
    strand_friction: Number
    """[N]."""
    pretension: Number
    """[N]."""
    strand_strength: Number
    """[N]."""
    motor_speed: Number
    """[m/s]."""
    motor_force: Number
    """[N]."""
    pulley_radius: Number
    """[m]."""
    name: str = struct.field(pytree_node=False)
    joints_per_segment: tuple[int, ...] = struct.field(pytree_node=False)
    cable_numbers: tuple[tuple[int, int], ...] = struct.field(pytree_node=False)
    """The number each cable goes by on the machine, per segment."""
    joint_model: str = struct.field(pytree_node=False)
    """"spherical" (constant height) or "rolling"."""

    kind = "quaternion_arm"

    @functools.cached_property
    def config(self) -> QuaternionArmConfig:
        """The description of these numbers, on the host.

        Raises:
            ConfigError: they contradict each other, are those of a batch of arms, or are traced by JAX.
        """
        mapping: dict[str, Any] = {"kind": self.kind, "schema": 1, "name": self.name}
        mapping |= {"joints_per_segment": self.joints_per_segment} | described(self, _PLACES, _NUM_AXES)
        mapping["cables"]["names"] = self.cable_numbers
        config = build(QuaternionArmConfig, mapping, "robot")
        if self.joint_model != _joint_model(config.joint):
            raise ConfigError(
                f"robot {self.name}: got pins {config.joint.pin_distance:g} m apart and {config.joint.plate_to_pin:g} m off "
                f"their plates in a {self.joint_model} joint, allowed: both 0 where spherical, else joint_model=rolling"
            )
        return config

    @property
    def bend_limit(self) -> jax.Array:
        """Largest commanded theta [rad]."""
        return jnp.radians(self.bend_limit_deg)

    @property
    def stop(self) -> jax.Array:
        """theta at the mechanical stop [rad]."""
        return jnp.radians(self.bend_limit_deg + self.stop_margin_deg)

    @property
    def hole_angles(self) -> jax.Array:
        """(num_segments, 2) [rad]."""
        return jnp.radians(self.hole_angles_deg)

    @property
    def strand_stiffness(self) -> Number:
        """Of a strand and its tensioner in series [N/m]."""
        if self.tensioner_stiffness is None:
            return self.cord_stiffness
        return 1.0 / (1.0 / self.cord_stiffness + 1.0 / self.tensioner_stiffness)

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
    return QuaternionArm(
        **leaves_of(config, _PLACES),
        name=config.name,
        joints_per_segment=config.joints_per_segment,
        cable_numbers=config.cables.names,
        joint_model=_joint_model(config.joint),
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


def _joint_model(joint: JointConfig) -> str:
    return "spherical" if joint.pin_distance == 0.0 and joint.plate_to_pin == 0.0 else "rolling"
