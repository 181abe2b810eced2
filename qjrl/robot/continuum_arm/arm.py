"""The continuum arm as a pytree: every number of its description is a traced leaf and stands here alone."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.config import build
from qjrl.robot.continuum_arm.description import ContinuumArmConfig
from qjrl.robot.continuum_arm.rod import Discretisation
from qjrl.robot.kind import Robot
from qjrl.robot.leaves import Number, described, leaves_of

# Leaf -> its place in the description.
_PLACES = {
    "segment_lengths": "segments.lengths",
    "anchor_radii": "segments.anchor_radii",
    "bend_limit_deg": "segments.bend_limit_deg",
    "anchor_angles_deg": "cables.anchor_angles_deg",
    "cable_stiffness": "cables.stiffness",
    "pretension": "cables.pretension",
    "friction_coefficient": "cables.friction_coefficient",
    "wrap_angle": "cables.wrap_angle",
    "cable_strength": "cables.strength",
    "bending_stiffness": "rod.bending_stiffness",
    "torsional_stiffness": "rod.torsional_stiffness",
    "axial_stiffness": "rod.axial_stiffness",
    "disc_mass": "masses.disc",
    "disc_depth": "masses.disc_depth",
    "hose_mass": "masses.hose",
    "payload": "masses.payload",
    "payload_height": "masses.payload_height",
    "gravity": "masses.gravity",
    "anchor_position_error": "defects.anchor_position",
    "home_length_error": "defects.home_length",
    "cable_gain_error": "defects.cable_gain",
    "tip_angle_error_deg": "defects.tip_angle_deg",
    "preset_bend_error": "defects.preset_bend",
    "measured_position_error": "measurement.position",
    "measured_angle_error_deg": "measurement.angle_deg",
    "motor_speed": "motors.speed",
    "motor_force": "motors.force",
    "pulley_radius": "motors.pulley_radius",
}
_NUM_AXES = {"segment_lengths": 1, "anchor_radii": 1, "anchor_angles_deg": 2, "gravity": 1}


@struct.dataclass
class ContinuumArm(Robot):
    """Numbers are leaves; names and the seed of the defects are static. Meaning and range of each: `description`."""

    segment_lengths: Any
    """(num_segments,) [m]."""
    anchor_radii: Any
    """(num_segments,) [m]."""
    bend_limit_deg: Number
    """Of every segment [deg]."""
    anchor_angles_deg: Any
    """(num_segments, cables of a segment) [deg]."""
    cable_stiffness: Number
    """[N/m]."""
    pretension: Number
    """[N]."""
    friction_coefficient: Number
    wrap_angle: Number
    """[rad]."""
    cable_strength: Number
    """[N]."""
    bending_stiffness: Number
    """[N m^2]."""
    torsional_stiffness: Number
    """[N m^2]."""
    axial_stiffness: Number
    """[N]."""
    disc_mass: Number
    """[kg]."""
    disc_depth: Number
    """[m]."""
    hose_mass: Number
    """[kg]."""
    payload: Number
    """[kg]."""
    payload_height: Number
    """[m]."""
    gravity: Any
    """(3,) [m/s^2]."""
    anchor_position_error: Number
    """[m]."""
    home_length_error: Number
    """[m]."""
    cable_gain_error: Number
    tip_angle_error_deg: Number
    """[deg]."""
    preset_bend_error: Number
    """[rad]."""
    measured_position_error: Number
    """[m]."""
    measured_angle_error_deg: Number
    """[deg]."""
    motor_speed: Number
    """[m/s]."""
    motor_force: Number
    """[N]."""
    pulley_radius: Number
    """[m]."""
    name: str = struct.field(pytree_node=False)
    cable_numbers: tuple[tuple[int, ...], ...] = struct.field(pytree_node=False)
    """The number each cable goes by on the machine, per segment."""
    defects_seed: int = struct.field(pytree_node=False)

    kind = "continuum_arm"
    strand_friction = 0.0
    """Its friction is the capstan's: a share of the tension, no force."""

    @functools.cached_property
    def config(self) -> ContinuumArmConfig:
        """The description of these numbers, on the host.

        Raises:
            ConfigError: they contradict each other, are those of a batch of arms, or are traced by JAX.
        """
        mapping: dict[str, Any] = {"kind": self.kind, "schema": 1, "name": self.name}
        mapping |= described(self, _PLACES, _NUM_AXES)
        mapping["cables"]["names"], mapping["defects"]["seed"] = self.cable_numbers, self.defects_seed
        return build(ContinuumArmConfig, mapping, "robot")

    @property
    def bend_limit(self) -> jax.Array:
        """Largest commanded theta of a segment [rad]."""
        return jnp.radians(self.bend_limit_deg)

    @property
    def anchor_directions(self) -> jax.Array:
        """Unit vectors (num_segments, cables of a segment, 2) from a disc's centre to its anchors."""
        angles = jnp.radians(jnp.asarray(self.anchor_angles_deg))
        return jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1)

    @property
    def num_segments(self) -> int:
        return len(self.cable_numbers)

    @property
    def cables_per_segment(self) -> int:
        return len(self.cable_numbers[0])

    @property
    def num_cables(self) -> int:
        return self.num_segments * self.cables_per_segment

    @property
    def num_positions(self) -> int:
        """Modes of all rods: what the simulated arm's statics solves for."""
        return self.num_segments * Discretisation().size

    @property
    def num_strands(self) -> int:
        """Every cable is one."""
        return self.num_cables


def arm_from_config(config: ContinuumArmConfig) -> ContinuumArm:
    """The pytree of a checked description."""
    return ContinuumArm(
        **leaves_of(config, _PLACES),
        name=config.name,
        cable_numbers=config.cables.names,
        defects_seed=config.defects.seed,
    )
