"""A simulated continuum arm: elastic rods, cables that stretch and only pull, discs with masses, and what is wrong with it."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Float

from qjrl.geometry.vectors import Vector
from qjrl.robot.continuum_arm.rod import RodShape, RodStiffness
from qjrl.robot.continuum_arm.segment import segment_bend


@struct.dataclass
class Plant:
    """All numbers of one arm of S segments with C cables each, at least three; every one can be differentiated.

    A segment is a rod between two discs. Its cables run from the lower to the upper disc, in its frames along z.
    """

    length: Any
    """(S,) of the rods without load [m]."""
    anchor_radius: Any
    """(S,) on which the anchors lie by the nominal model [m]."""
    anchor_directions: Any
    """(S, C, 2) unit vectors to them."""
    bending_stiffness: Any
    """(S,) EI [N m^2]."""
    torsional_stiffness: Any
    """(S,) GJ [N m^2]."""
    axial_stiffness: Any
    """(S,) EA [N]."""
    preset_bend: Any
    """(S, 2) of a rod without load, in x and in y, a whole segment's [rad]."""
    disc_mass: Any
    """(S,) of the disc at each segment's end [kg]."""
    hose_mass: Any
    """(S,) spread evenly over each rod [kg]."""
    payload: Any
    """() behind the last disc [kg]."""
    disc_depth: Any
    """(S,) from a segment's end back to its disc's centre of mass [m]."""
    payload_height: Any
    """() from the last segment's end on to the payload's centre of mass [m]."""
    lower_anchors: Any
    """(S, C, 2) x and y on the disc below each segment [m]."""
    upper_anchors: Any
    """(S, C, 2) x and y on the disc above it [m]."""
    cable_stiffness: Any
    """() [N/m]."""
    pretension: Any
    """() of a cable whose anchors are one segment's length apart, at home [N]."""
    cable_gain: Any
    """(S, C) change of a cable's rest length for one of its command."""
    home_offset: Any
    """(S, C) of a cable's rest length [m]."""
    friction: Any
    """() of a cable on its guides, mu."""
    base_wrap: Any
    """() angle that a cable wraps around guides with all segments straight [rad]."""
    reversal_travel: Any
    """() travel of a command after which friction has turned round, to 76 % [m]."""
    slack_length: Any
    """() over which a cable goes from slack to taut [m]."""
    tip_rotation: Any
    """(3,) rotation vector of the measured tip's frame in the last disc's [rad]."""
    gravity: Any
    """(3,) in the frame of the base [m/s^2]."""

    @property
    def num_segments(self) -> int:
        """S."""
        return self.lower_anchors.shape[0]

    @property
    def num_cables(self) -> int:
        """C, of each segment."""
        return self.lower_anchors.shape[1]

    @property
    def stiffness(self) -> RodStiffness:
        """Of each rod, (S, 1)."""
        bending, torsion = self.bending_stiffness / self.length, self.torsional_stiffness / self.length
        stretch = self.axial_stiffness * self.length
        return RodStiffness(bending[:, None], torsion[:, None], stretch[:, None])


def nominal_plant(
    *,
    length: Any,
    anchor_radius: Any,
    num_cables: int = 4,
    anchor_directions: Any = None,
    bending_stiffness: Any = 0.6,
    torsional_stiffness: Any = 0.6,
    axial_stiffness: Any = 5e4,
    disc_mass: Any = 0.35,
    hose_mass: Any = 0.05,
    disc_depth: Any = 0.005,
    payload: float = 0.5,
    payload_height: float = 0.02,
    cable_stiffness: float = 3e4,
    pretension: float = 40.0,
    friction: float = 0.15,
    base_wrap: float = 0.5,
    gravity: Any = (9.81, 0.0, 0.0),
) -> Plant:
    """An arm without defects; units as in `Plant`.

    Args:
        length: of every segment (S,).
        anchor_radius, the stiffnesses, disc_mass, disc_depth, hose_mass: one for all segments or (S,).
        anchor_directions: (S, C, 2) unit vectors; None: `num_cables` evenly, clockwise from x.
    """
    lengths = np.array(length, np.float64)
    count = len(lengths)
    each = lambda value: np.broadcast_to(np.asarray(value, np.float64), count).copy()  # noqa: E731
    directions = _even_directions(num_cables) if anchor_directions is None else np.asarray(anchor_directions)
    directions = np.broadcast_to(directions, (count, *directions.shape[-2:]))
    anchors = each(anchor_radius)[:, None, None] * directions
    number = np.float64
    return Plant(
        length=lengths,
        anchor_radius=each(anchor_radius),
        anchor_directions=directions.copy(),
        bending_stiffness=each(bending_stiffness),
        torsional_stiffness=each(torsional_stiffness),
        axial_stiffness=each(axial_stiffness),
        preset_bend=np.zeros((count, 2)),
        disc_mass=each(disc_mass),
        hose_mass=each(hose_mass),
        payload=number(payload),
        disc_depth=each(disc_depth),
        payload_height=number(payload_height),
        lower_anchors=anchors,
        upper_anchors=anchors.copy(),
        cable_stiffness=number(cable_stiffness),
        pretension=number(pretension),
        cable_gain=np.ones(anchors.shape[:2]),
        home_offset=np.zeros(anchors.shape[:2]),
        friction=number(friction),
        base_wrap=number(base_wrap),
        reversal_travel=number(5e-4),
        slack_length=number(2e-5),
        tip_rotation=np.zeros(3),
        gravity=np.asarray(gravity, np.float64),
    )


def _even_directions(num_cables: int) -> np.ndarray:
    azimuths = -2.0 * np.pi / num_cables * np.arange(num_cables)
    return np.stack([np.cos(azimuths), np.sin(azimuths)], axis=1)


@struct.dataclass
class Cables:
    """What a command makes of the cables."""

    rest_length: Any
    """(C, S, n) [m]."""
    stiffness: Any
    """(C, S, n) with friction [N/m]."""


def cables_of(plant: Plant, commands: Float[Array, "n S C"], previous: Float[Array, "n S C"]) -> Cables:
    """Cables of commands [m] relative to home, + pays out, after the previous ones."""
    rest = (
        plant.cable_gain * commands
        + plant.length[:, None]
        + plant.home_offset
        - plant.pretension / plant.cable_stiffness
    )
    bends = _norm(nominal_bends(plant, commands))
    wrap = plant.base_wrap + jnp.cumsum(bends, axis=1) - bends
    direction = jnp.tanh((commands - previous) / plant.reversal_travel)
    stiffness = plant.cable_stiffness * jnp.exp(direction * plant.friction * wrap[:, :, None])
    return Cables(rest.transpose(2, 1, 0), stiffness.transpose(2, 1, 0))


def nominal_bends(plant: Plant, commands: Float[Array, "n S C"]) -> Float[Array, "n S 2"]:
    """Bend of each segment [rad] that cables [m] relative to home mean by the nominal model."""
    of_row = jax.vmap(segment_bend)
    return jax.vmap(lambda row: of_row(plant.anchor_radius, plant.anchor_directions, row))(commands)


def _norm(vectors: jax.Array) -> jax.Array:
    """Of the last axis; its slope at zero is zero."""
    squared = jnp.sum(vectors**2, axis=-1)
    is_zero = squared == 0.0
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, squared)))


def cable_lengths(plant: Plant, shape: RodShape) -> Any:
    """Distance (C, S, n) [m] of the anchors of each cable of rods (S, n)."""
    (lower_x, lower_y), (upper_x, upper_y) = (
        tuple(anchors.transpose(2, 1, 0)[..., None]) for anchors in (plant.lower_anchors, plant.upper_anchors)
    )
    upper = shape.end + shape.rotation.x.scaled(upper_x) + shape.rotation.y.scaled(upper_y)
    between = upper - Vector(lower_x, lower_y, 0.0)
    return jnp.sqrt(between.dot(between))


def stretched(plant: Plant, cables: Cables, lengths: Any) -> tuple[Any, Any, Any]:
    """Stretch (C, S, n) [m] of cables of those lengths, smooth and never below zero, its slope and second slope by them."""
    stretch = lengths - cables.rest_length
    root = jnp.sqrt(stretch**2 + plant.slack_length**2)
    return 0.5 * (stretch + root), 0.5 * (1.0 + stretch / root), 0.5 * plant.slack_length**2 / root**3


def cable_tensions(plant: Plant, cables: Cables, lengths: Any) -> Any:
    """(C, S, n) [N] of cables of those lengths."""
    stretch, slope, _ = stretched(plant, cables, lengths)
    return cables.stiffness * stretch * slope
