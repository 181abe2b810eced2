"""The shape of an elastic rod from the modes of its strains: it bends, twists and stretches, and does not shear.

A strain is a sum of Legendre polynomials along the rod. The shape follows by Magnus steps of order four on SE(3); only the
mean position along a step, for the weight of a hose, is of order two.
Modes come first and a batch of rods last, so that each number is one long row for the processor.
"""

import dataclasses
import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.geometry.vectors import Matrix, Vector


@dataclasses.dataclass(frozen=True)
class Discretisation:
    """How many numbers describe a rod, and in how many steps its shape is found."""

    bending: int = 4
    """Modes in each of two directions."""
    torsion: int = 2
    """Modes."""
    stretch: int = 1
    """Modes."""
    steps: int = 4
    """Along the rod; each must turn by less than 1.5 rad, where the series of `_exponential` ends."""

    @property
    def size(self) -> int:
        """Numbers of a rod: bends in x and in y [rad], twists [rad], stretches (no unit), each by rising mode."""
        return 2 * self.bending + self.torsion + self.stretch

    def parts(self, modes: Any) -> tuple[Any, Any, Any, Any]:
        """Bends in x, bends in y, twists and stretches of (size, ...)."""
        first, second, third = self.bending, 2 * self.bending, 2 * self.bending + self.torsion
        return modes[:first], modes[first:second], modes[second:third], modes[third:]


@struct.dataclass
class RodShape:
    """A rod in the frame of its base."""

    end: Vector
    """Position of the end [m]."""
    rotation: Matrix
    """Of the end's frame."""
    first_moment: Vector
    """Integral of the position over the rod, a share of its length at each point [m]."""


def rod_shape(modes: jax.Array, length: Any, counts: Discretisation) -> RodShape:
    """The shape of rods that start at the origin along z.

    Args:
        modes: (counts.size, *batch), in the order of `Discretisation.size`.
        length: (*batch) of the rod without load [m].
    """
    shapes = _pieces(modes, length, counts)
    shares = np.full(counts.steps, 1.0 / counts.steps)
    while len(shares) > 1:
        shares, shapes = _joined_by_twos(shares, shapes)
    return _part(shapes, 0)


def _part(shapes: RodShape, places: Any) -> RodShape:
    return jax.tree.map(lambda values: values[places], shapes)


def _joined_by_twos(shares: np.ndarray, shapes: RodShape) -> tuple[np.ndarray, RodShape]:
    """Every second piece at the end of the one before it; a last odd one stays. Pieces are the first axis."""
    even = len(shares) // 2 * 2
    near, far = slice(0, even, 2), slice(1, even, 2)
    far_shares = shares[far].reshape(-1, *[1] * (jnp.ndim(shapes.end.x) - 1))
    joined = _joined(_part(shapes, near), _part(shapes, far), far_shares)
    if even < len(shares):
        rest = _part(shapes, slice(even, None))
        joined = jax.tree.map(lambda *values: jnp.concatenate(values), joined, rest)
    return np.append(shares[near] + shares[far], shares[even:]), joined


def _joined(near: RodShape, far: RodShape, far_share: Any) -> RodShape:
    """Two pieces, the far one, of `far_share` of the rod, at the end of the near one."""
    end = near.end + near.rotation.times(far.end)
    moment = near.first_moment + near.end.scaled(far_share) + near.rotation.times(far.first_moment)
    return RodShape(end, near.rotation.product(far.rotation), moment)


def _pieces(modes: jax.Array, length: Any, counts: Discretisation) -> RodShape:
    """The shape of each step in its own frame; steps are the first axis."""
    step = 1.0 / counts.steps
    middles = (np.arange(counts.steps) + 0.5) * step
    half_width = step / math.sqrt(12.0)
    turn_1, pull_1 = _strains(modes, length, middles - half_width, counts)
    turn_2, pull_2 = _strains(modes, length, middles + half_width, counts)
    commutator = math.sqrt(3.0) / 12.0 * step**2
    turn = (turn_1 + turn_2).scaled(step / 2.0) + turn_1.cross(turn_2).scaled(commutator)
    twisted = turn_1.cross(pull_2) - turn_2.cross(pull_1)
    pull = (pull_1 + pull_2).scaled(step / 2.0) + twisted.scaled(commutator)
    return _exponential(turn, pull, step)


def _strains(modes: jax.Array, length: Any, places: np.ndarray, counts: Discretisation) -> tuple[Vector, Vector]:
    """Turn [rad] and pull [m] for a whole length of the rod, components (places, *batch), at shares of its length."""
    bend_x, bend_y, twist, stretch = (_at(places, part) for part in counts.parts(modes))
    return Vector(-bend_y, bend_x, twist), Vector(0.0, 0.0, length * (1.0 + stretch))


def _at(places: np.ndarray, modes: jax.Array) -> Any:
    """Legendre series (places, *batch) of modes (count, *batch); zero where there are none."""
    values = np.polynomial.legendre.legvander(2.0 * places - 1.0, max(len(modes) - 1, 0))
    columns = values.reshape(*values.shape, *[1] * (modes.ndim - 1))
    terms = [columns[:, number] * mode for number, mode in enumerate(modes)]
    return functools.reduce(lambda a, b: a + b, terms) if terms else np.zeros((len(places), *modes.shape[1:]))


def _exponential(turn: Vector, pull: Vector, share: float) -> RodShape:
    """The shape of a piece of constant strain: exp of the twist (turn [rad], pull [m])."""
    squared = turn.dot(turn)
    b, c, d = (_series(squared, first) for first in (2, 3, 4))
    once, twice = turn.cross(pull), turn.cross(turn.cross(pull))
    end = pull + once.scaled(b) + twice.scaled(c)
    # Integral of the position over the piece: the same series, each integrated once more.
    moment = (pull.scaled(0.5) + once.scaled(c) + twice.scaled(d)).scaled(share)
    return RodShape(end, rotation_by(turn), moment)


def rotation_by(turn: Vector) -> Matrix:
    """Rotation by a vector of at most 1.5 rad."""
    squared = turn.dot(turn)
    b = _series(squared, 2)
    cosine, a = 1.0 - squared * b, 1.0 - squared * _series(squared, 3)
    bx, by, bz = (b * value for value in (turn.x, turn.y, turn.z))
    return Matrix(
        Vector(cosine + bx * turn.x, by * turn.x + a * turn.z, bz * turn.x - a * turn.y),
        Vector(bx * turn.y - a * turn.z, cosine + by * turn.y, bz * turn.y + a * turn.x),
        Vector(bx * turn.z + a * turn.y, by * turn.z - a * turn.x, cosine + bz * turn.z),
    )


def _series(squared: Any, first: int) -> Any:
    """1/first! - x/(first + 2)! + x^2/(first + 4)! - ..., smooth at x = 0 with all its slopes."""
    return _polynomial(tuple((-1) ** number / math.factorial(first + 2 * number) for number in range(_TERMS)), squared)


# Enough for full double precision up to a turn of 1.5 rad.
_TERMS = 9


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _polynomial(coefficients: tuple[float, ...], x: Any) -> Any:
    """Of rising powers. Its slope is one polynomial and one product, where that of Horner's rule is three operations a term."""
    value, *others = reversed(coefficients)
    for coefficient in others:
        value = coefficient + x * value
    return value


@_polynomial.defjvp
def _polynomial_jvp(coefficients: tuple[float, ...], primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    (x,), (change,) = primals, tangents
    derived = tuple(number * coefficient for number, coefficient in enumerate(coefficients))[1:]
    return _polynomial(coefficients, x), _polynomial(derived, x) * change


def elastic_energy(modes: jax.Array, rest_bends: Any, stiffness: "RodStiffness", counts: Discretisation) -> jax.Array:
    """Energy (*batch) [J] of rods (counts.size, *batch) whose first bends are `rest_bends` (2, *batch) [rad] without load."""
    bend_x, bend_y, twist, stretch = counts.parts(modes)
    terms = [
        stiffness.bending * (_squared(bend_x, rest_bends[0]) + _squared(bend_y, rest_bends[1])),
        stiffness.torsion * _squared(twist),
        stiffness.stretch * _squared(stretch),
    ]
    return 0.5 * functools.reduce(lambda a, b: a + b, terms)


def elastic_slopes(stiffness: "RodStiffness", counts: Discretisation) -> list[Any]:
    """Second derivatives of the energy by each mode: it is diagonal in the modes."""
    spread = lambda value, count: [value / (2 * number + 1) for number in range(count)]  # noqa: E731
    bending = spread(stiffness.bending, counts.bending)
    return [*bending, *bending, *spread(stiffness.torsion, counts.torsion), *spread(stiffness.stretch, counts.stretch)]


def _squared(modes: jax.Array, rest: Any = 0.0) -> Any:
    """Mean square along the rod of a Legendre series, of its first number less `rest`."""
    shifted = [modes[0] - rest, *modes[1:]] if len(modes) else []
    return sum((mode * mode / (2 * number + 1) for number, mode in enumerate(shifted)), 0.0)


@struct.dataclass
class RodStiffness:
    """Of a whole rod: energy is half of it times the mean square of a strain over the length."""

    bending: Any
    """EI / L [N m]."""
    torsion: Any
    """GJ / L [N m]."""
    stretch: Any
    """EA L [N m]."""
