"""What the elliptical deviation does to a whole arm: to its tip, to the strands' common length, to their tension."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import as_mapping
from qjrl.robot import cable_lengths, robot_from_mapping, strand_commands, strand_lengths
from qjrl.robot.quaternion_arm.arm import QuaternionArm, require_arm
from qjrl.robot.quaternion_arm.joint import angles_of_bends
from qjrl.robot.quaternion_arm.sampling import uniform_bends
from qjrl.robot.quaternion_arm.tip import tip_position
from qjrl.robot.verbs import Robot
from qjrl.simulation import SettleConfig, settle


@dataclasses.dataclass(frozen=True)
class ArmEffects:
    """Over bends with theta uniform up to a limit and phi uniform."""

    tip_shift: np.ndarray
    """(n,) distance of the tip from that of the arm of constant H0 at the same cable lengths [m]."""
    common_part: np.ndarray
    """(n, cables) stretch of each loop's two strands beyond home [m]."""
    held_tension: np.ndarray
    """(n, strands) [N] if the arm were held at these bends, from the elastic strands alone; 0 where slack."""


@dataclasses.dataclass(frozen=True)
class SettledEffects:
    """A handful of poses in the physics."""

    held_tension: np.ndarray
    """(n, strands) [N] closed form, at the bends commanded."""
    settled_tension: np.ndarray
    """(n, strands) [N] of the physics at rest."""
    elastic_tension: np.ndarray
    """(n, strands) [N] closed form, at the bends where the physics rests."""
    commanded_angle: np.ndarray
    """(n, segments) bend angles commanded [rad]."""
    settled_angle: np.ndarray
    """(n, segments) at rest [rad]."""
    converged: np.ndarray
    """(n,)"""


def arm_with_joint(robot: Robot, crossed_link_length: float, pin_distance: float, plate_to_pin: float) -> Robot:
    """The same arm with other joints; lengths [m]."""
    mapping = as_mapping(robot.config)
    joint = {"crossed_link_length": crossed_link_length, "pin_distance": pin_distance, "plate_to_pin": plate_to_pin}
    return robot_from_mapping(mapping | {"joint": mapping["joint"] | joint})


def home_height(robot: Robot) -> float:
    """H0 [m] of a joint at home."""
    joint = robot.config.joint
    return float(np.sqrt(joint.crossed_link_length**2 - joint.pin_distance**2) + 2.0 * joint.plate_to_pin)


def draw_limited_bends(robot: Robot, limit: float, count: int, seed: int) -> np.ndarray:
    """Bends (count, segments, 2), theta uniform up to `limit` [rad]."""
    limited = robot.replace(bend_limit_deg=math.degrees(limit))  # pyright: ignore[reportAttributeAccessIssue]
    keys = jax.random.split(jax.random.key(seed), count)
    return np.asarray(jax.jit(jax.vmap(lambda key: uniform_bends(limited, key)))(keys))


def effects_on_arm(robot: Robot, bends: np.ndarray) -> ArmEffects:
    """Closed form, for bends (n, segments, 2): the same bends have the same cable lengths whatever H does."""
    flat = arm_with_joint(robot, home_height(robot), 0.0, 0.0)
    arms = (require_arm(one, "elliptical_deviation") for one in (robot, flat))
    shift, common, tension = _effects(*arms, jnp.asarray(bends))
    return ArmEffects(np.asarray(shift), np.asarray(common), np.asarray(tension))


def settled_effects(robot: Robot, simulation: SettleConfig, bends: np.ndarray) -> SettledEffects:
    """Settle the cable lengths of bends (n, segments, 2) and compare tensions with the closed form's."""
    lengths = _lengths(robot, jnp.asarray(bends))
    rest = settle(robot, lengths, config=simulation)
    return SettledEffects(
        held_tension=np.asarray(_tensions(robot, jnp.asarray(bends), lengths)),
        settled_tension=rest.strand_tension,
        elastic_tension=np.asarray(_tensions(robot, jnp.asarray(rest.bends), lengths)),
        commanded_angle=angles_of_bends(bends),
        settled_angle=angles_of_bends(rest.bends),
        converged=rest.converged,
    )


def strand_tension(robot: Robot, bends: jax.Array, lengths: jax.Array) -> jax.Array:
    """Tension (strands,) [N] of elastic strands at bends (segments, 2) when the cables are set to `lengths` [m].

    EA/L times what the strand is longer than its rest length, which holds the pretension's stretch at home; never below 0.
    """
    stretch = strand_lengths(robot, bends) - strand_commands(robot, lengths)
    return jnp.maximum(robot.strand_stiffness * stretch, 0.0)


@jax.jit
def _effects(robot: QuaternionArm, spherical: QuaternionArm, bends: jax.Array):
    def one(row):
        shift = jnp.linalg.norm(tip_position(robot, row) - tip_position(spherical, row))
        common = (strand_lengths(robot, row) - strand_lengths(spherical, row))[0::2]
        return shift, common, strand_tension(robot, row, cable_lengths(robot, row))

    return jax.vmap(one)(bends)


@jax.jit
def _lengths(robot: Robot, bends: jax.Array) -> jax.Array:
    return jax.vmap(lambda row: cable_lengths(robot, row))(bends)


@jax.jit
def _tensions(robot: Robot, bends: jax.Array, lengths: jax.Array) -> jax.Array:
    return jax.vmap(lambda row, commanded: strand_tension(robot, row, commanded))(bends, lengths)
