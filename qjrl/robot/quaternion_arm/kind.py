"""The quaternion-joint arm as a kind of robot: its configuration is the bends (num_segments, 2), one pair a segment."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import ConfigError
from qjrl.robot.kind import Kind
from qjrl.robot.limits import Discs
from qjrl.robot.quaternion_arm import cables, coordinates, differential, kinematics, mjcf, relaxation, sampling, statics
from qjrl.robot.quaternion_arm.arm import QuaternionArm, arm_from_config
from qjrl.robot.quaternion_arm.description import QuaternionArmConfig
from qjrl.robot.quaternion_arm.drawing import DRAWING
from qjrl.robot.quaternion_arm.interface import INTERFACE
from qjrl.robot.quaternion_arm.joint import bend_angle, bend_from_vector, vector_from_bend
from qjrl.robot.quaternion_arm.minimal_engine import MinimalEngine
from qjrl.robot.quaternion_arm.mjcf_ties import straight_length
from qjrl.robot.quaternion_arm.naming import cable_numbers, strand_name
from qjrl.robot.quaternion_arm.particulars import PARTICULARS
from qjrl.robot.quaternion_arm.tip import tip_poses
from qjrl.robot.unit_hints import bend_hint


def home(arm: QuaternionArm) -> jax.Array:
    """The straight arm."""
    return jnp.zeros((arm.num_segments, 2))


def limits(arm: QuaternionArm) -> Discs:
    """Of the bend vectors: theta up to the bend limit, in every direction."""
    return Discs(arm.bend_limit)


def largest(arm: QuaternionArm) -> jax.Array:
    """The bend of the bend limit."""
    return jnp.sin(arm.bend_limit / 2.0)


def within_limits(arm: QuaternionArm, bends: jax.Array) -> jax.Array:
    """Each segment's bend shortened to that of the bend limit."""
    return Discs(largest(arm)).within(bends.reshape(-1)).reshape(bends.shape)


def check_bends(arm: QuaternionArm, bends: np.ndarray, where: str) -> None:
    """Refuse bends (n, num_segments, 2) of 180 degrees and more."""
    sizes = np.linalg.norm(bends, axis=-1)
    largest_size = float(sizes.max())
    if largest_size >= 1.0:
        segment = int(np.argmax(sizes)) % arm.num_segments
        raise ConfigError(
            f"{where}: segment {segment} (the first is 0): got a bend of length {largest_size:.4g}, allowed: below 1, "
            f"sin(theta/2) (cos phi, sin phi){bend_hint(largest_size)}"
        )


def vectors_of_bends(arm: QuaternionArm, bends: jax.Array) -> jax.Array:
    """Bend vectors theta (cos phi, sin phi) of all segments in a row [rad]."""
    del arm
    return jax.vmap(vector_from_bend)(bends).reshape(-1)


def bends_of_vectors(arm: QuaternionArm, vectors: jax.Array) -> jax.Array:
    """Inverse of `vectors_of_bends`."""
    return jax.vmap(bend_from_vector)(vectors.reshape(arm.num_segments, 2))


def tip(arm: QuaternionArm, vectors: jax.Array) -> differential.Tip:
    """Tip and Jacobian of bend vectors (2 num_segments, *batch)."""
    return differential.tip_of(arm, vectors.reshape(arm.num_segments, 2, *vectors.shape[1:]))


def motor_force(arm: QuaternionArm, strand_tension: Any) -> Any:
    """Difference (..., cables) [N] of each loop's two strands, of tensions (..., strands) [N]."""
    del arm
    return strand_tension[..., 0::2] - strand_tension[..., 1::2]


def at_pretension(arm: QuaternionArm, pretension: float) -> QuaternionArm:
    """The arm whose strands have this tension at home [N]."""
    return dataclasses.replace(arm, pretension=pretension)


def encoders(arm: QuaternionArm) -> tuple[int, ...]:
    """A segment's reading is the mean over its joints."""
    return arm.joints_per_segment


def excess(arm: QuaternionArm, bends: jax.Array) -> jax.Array:
    """Of the joint that is bent furthest [rad]."""
    return jnp.max(jax.vmap(bend_angle)(bends)) - arm.stop


def cable_names(arm: QuaternionArm) -> tuple[str, ...]:
    """ "cable_NUMBER" of every cable, by the number it goes by on the machine."""
    return tuple(f"cable_{number}" for number in cable_numbers(arm))


def strand_names(arm: QuaternionArm) -> tuple[str, ...]:
    """Of every strand, see `naming.strand_name`."""
    return tuple(strand_name(arm, strand) for strand in range(arm.num_strands))


QUATERNION_ARM = Kind(
    description=QuaternionArmConfig,
    make=arm_from_config,
    home=home,
    limits=limits,
    forward_kinematics=kinematics.forward_kinematics,
    from_unit_cube=sampling.bends_from_unit_cube,
    largest=largest,
    random=sampling.uniform_bends,
    configuration_name="bends",
    check=check_bends,
    to_coordinates=vectors_of_bends,
    from_coordinates=bends_of_vectors,
    tip=tip,
    plain_poses=tip_poses,
    within_limits=within_limits,
    at_distance=sampling.bends_at_distance,
    cable_lengths=cables.cable_lengths,
    configuration_from_cables=cables.bends_from_cables,
    cable_strokes=cables.cable_strokes,
    strand_lengths=cables.strand_lengths,
    strand_commands=cables.strand_commands,
    motor_force=motor_force,
    equilibrium=statics.equilibrium,
    at_pretension=at_pretension,
    strand_tension=statics.strand_tension,
    encoders=encoders,
    excess=excess,
    is_at_strength=statics.is_at_strength,
    build_mjcf=mjcf.build_mjcf,
    stand_in=relaxation.stand_in,
    minimal_engine=MinimalEngine,
    joint_positions=coordinates.joint_positions,
    configuration_from_joint_positions=coordinates.bends_from_joint_positions,
    drawing=DRAWING,
    interface=INTERFACE,
    particulars=PARTICULARS,
    reach=straight_length,
    cable_names=cable_names,
    strand_names=strand_names,
)
