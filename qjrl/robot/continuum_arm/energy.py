"""Energy of a continuum arm: of its rods, of its cables, and of its weight.

Only weight couples the segments. What lies beyond a segment is a rigid body to it, and what lies before turns gravity.
So the energy's slope by a segment's modes is that of the energy of this one segment under such a load.
Modes are (size, S, n) for S segments and a batch of n arms.
"""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.geometry.vectors import IDENTITY, ZERO, Matrix, Vector
from qjrl.robot.continuum_arm.plant import Cables, Plant, cable_lengths, stretched
from qjrl.robot.continuum_arm.rod import Discretisation, RodShape, elastic_energy, rod_shape


@struct.dataclass
class Chain:
    """All segments one after the other, in the frame of the base; components (S, n)."""

    base: Matrix
    """Rotation of each segment's base."""
    gravity: Vector
    """In the frame of each segment's base [m/s^2]."""
    beyond: Vector
    """First moment of all masses beyond each segment's rod, about its end, in its end's frame [kg m]."""
    tip: Vector
    """Position of the last segment's end (n,) [m]."""
    tip_rotation: Matrix
    """Of the last segment's end (n,)."""


def shapes_of(plant: Plant, modes: jax.Array, counts: Discretisation) -> RodShape:
    """The shape of each rod, components (S, n)."""
    return rod_shape(modes, plant.length[:, None], counts)


def chain_of(plant: Plant, shapes: RodShape) -> Chain:
    """The segments one after the other."""
    count = plant.num_segments
    single = [jax.tree.map(lambda values, number=number: values[number], shapes) for number in range(count)]
    ends, rotations = [ZERO], [IDENTITY]
    for shape in single:
        ends.append(ends[-1] + rotations[-1].times(shape.end))
        rotations.append(rotations[-1].product(shape.rotation))
    moment = _weighed(plant, count - 1) + Vector(0.0, 0.0, plant.payload * plant.payload_height)
    moments = [moment]
    masses = masses_beyond(plant)
    for number in reversed(range(1, count)):
        moment = _weighed(plant, number - 1) + _first_moment(
            single[number], moments[0], masses[number], plant.hose_mass[number]
        )
        moments.insert(0, moment)
    gravity = Vector(*plant.gravity)
    like = jnp.zeros_like(shapes.end.x)
    stacked = lambda parts: jax.tree.map(  # noqa: E731
        lambda *values: jnp.stack([value + row for value, row in zip(values, like, strict=True)]), *parts
    )
    return Chain(
        base=stacked(rotations[:-1]),
        gravity=stacked([rotation.transposed_times(gravity) for rotation in rotations[:-1]]),
        beyond=stacked(moments),
        tip=ends[-1],
        tip_rotation=rotations[-1],
    )


def masses_beyond(plant: Plant) -> Any:
    """(S,) mass of all that lies beyond each rod [kg]."""
    carried = plant.disc_mass + plant.hose_mass
    return jnp.cumsum(carried[::-1])[::-1] - plant.hose_mass + plant.payload


def _weighed(plant: Plant, number: int) -> Vector:
    """First moment of the disc at a segment's end, in its frame."""
    return Vector(0.0, 0.0, -plant.disc_mass[number] * plant.disc_depth[number])


def _first_moment(shape: RodShape, beyond: Vector, mass_beyond: Any, hose_mass: Any) -> Vector:
    """First moment of a rod and of all beyond it, about its base, in its base's frame [kg m]."""
    return shape.first_moment.scaled(hose_mass) + shape.end.scaled(mass_beyond) + shape.rotation.times(beyond)


def first_moments(plant: Plant, shapes: RodShape, chain: Chain) -> Vector:
    """First moment (S, n) [kg m] of each segment and of all beyond it, about its base, in its base's frame."""
    return _first_moment(shapes, chain.beyond, masses_beyond(plant)[:, None], plant.hose_mass[:, None])


def elastic_and_cable_energy(
    plant: Plant, cables: Cables, modes: jax.Array, lengths: Any, counts: Discretisation
) -> jax.Array:
    """(S, n) [J] of each rod and of its cables of these lengths (C, S, n) [m]."""
    stretch, _, _ = stretched(plant, cables, lengths)
    elastic = elastic_energy(modes, plant.preset_bend.T[:, :, None], plant.stiffness, counts)
    return elastic + 0.5 * jnp.sum(cables.stiffness * stretch**2, axis=0)


def energy_and_residual(
    plant: Plant, cables: Cables, modes: jax.Array, counts: Discretisation
) -> tuple[jax.Array, jax.Array]:
    """Energy (n,) of each arm [J], and its slope by every mode (size, S, n) [J], which is zero at rest."""
    chain = chain_of(plant, shapes_of(plant, modes, counts))
    sloped = jax.grad(lambda moved: _under_load(plant, cables, chain, moved, counts), has_aux=True)
    slope, moving = sloped(modes)
    weight = moving.first_moments.dot(chain.gravity)[0]  # the first segment carries all the others
    return jnp.sum(moving.own_energy, axis=0) - weight, slope


def residual(plant: Plant, cables: Cables, modes: jax.Array, counts: Discretisation) -> jax.Array:
    """Slope of the energy by every mode (size, S, n) [J]."""
    return energy_and_residual(plant, cables, modes, counts)[1]


@struct.dataclass
class _Moving:
    """What moves with the modes."""

    shapes: RodShape
    first_moments: Vector
    lengths: Any
    own_energy: Any
    """(S, n) of rods and cables."""


def _under_load(
    plant: Plant, cables: Cables, chain: Chain, modes: jax.Array, counts: Discretisation
) -> tuple[jax.Array, _Moving]:
    """Energy of all segments of all arms, each under a load that does not move."""
    shapes = shapes_of(plant, modes, counts)
    moments, lengths = first_moments(plant, shapes, chain), cable_lengths(plant, shapes)
    own = elastic_and_cable_energy(plant, cables, modes, lengths, counts)
    return jnp.sum(own - moments.dot(chain.gravity)), _Moving(shapes, moments, lengths, own)


@struct.dataclass
class Curvature:
    """Second derivatives of the energy by the modes, and what they are made of."""

    blocks: jax.Array
    """(size, size, S, n) of each segment alone."""
    lever: Vector
    """(size, S, n) gravity times how each mode turns all beyond the segment, in the frame of the base [m/s^2]."""
    swing: Vector
    """(size, S, n) how each mode moves the first moment of the segment and all beyond, in the frame of the base [kg m]."""
    lengths: Any
    """(C, S, n) of the cables [m]."""
    length_slopes: Any
    """(size, C, S, n) of the cables by the modes [m]."""


def curvature_of(plant: Plant, cables: Cables, modes: jax.Array, counts: Discretisation) -> Curvature:
    """At modes (size, S, n)."""
    chain = chain_of(plant, shapes_of(plant, modes, counts))
    sloped = jax.grad(lambda moved: _under_load(plant, cables, chain, moved, counts), has_aux=True)
    directions = jnp.eye(counts.size).reshape(counts.size, counts.size, 1, 1)

    def along(direction: jax.Array) -> Any:
        return jax.jvp(sloped, (modes,), (jnp.broadcast_to(direction, modes.shape),))

    (_, moving), (blocks, slopes) = jax.vmap(along, out_axes=(None, 0))(directions)
    turned = chain.base.times(_spin(moving.shapes.rotation, slopes.shapes.rotation))
    return Curvature(
        blocks=blocks,
        lever=Vector(*plant.gravity).cross(turned),
        swing=chain.base.times(slopes.first_moments),
        lengths=moving.lengths,
        length_slopes=slopes.lengths,
    )


def _spin(rotation: Matrix, slope: Matrix) -> Vector:
    """Angular velocity of a rotation that changes by `slope`, in the frame that it turns into."""
    columns = ("x", "y", "z")
    entry = lambda row, column: sum(  # noqa: E731
        getattr(getattr(slope, name), row) * getattr(getattr(rotation, name), column) for name in columns
    )
    return Vector(entry("z", "y"), entry("x", "z"), entry("y", "x"))
