"""One segment in the frame of its base: where its bodies are at the half angles of its joints, and how they move.

The half angles (x, y) of a joint are those of the MJCF's lower hinges: n = Rx(x) Ry(y) e_z is half-way through the joint.
A plate's columns follow from n without a matrix product: X' = X - 2 n_x n, Y' = Y - 2 n_y n, Z' = 2 n_z n - Z.
Every body, a chord or a link, is symmetric about an axis. "Drift" is what accelerates at constant rates of the half angles.
"""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.geometry import vectors
from qjrl.geometry.vectors import IDENTITY, ZERO, Matrix, Vector, add, times
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.joint import height_of_cosine


@struct.dataclass
class Place:
    """A point of the segment: a centre, a plate or the end."""

    at: Vector
    """[m]."""
    slope: tuple[Vector, Vector]
    """By each half angle [m/rad]."""
    drift: Vector
    """[m/s^2]."""


@struct.dataclass
class Spin:
    """How a body turns."""

    slope: tuple[Vector, Vector]
    """Angular velocity for a rate of each half angle."""
    rate: Vector
    """Angular velocity [rad/s]."""
    drift: Vector
    """Angular acceleration [rad/s^2]."""


@struct.dataclass
class Body:
    """Chord or link."""

    centre: Place
    axis: Vector
    spin: Spin


@struct.dataclass
class Scalar:
    """A number of the segment, its slopes and its drift."""

    at: Any
    slope: tuple[Any, Any]
    drift: Any


@struct.dataclass
class SegmentMotion:
    """A segment at half angles and their rates."""

    chords: list[Body]
    links: list[Body]
    end: Place
    rotation: Matrix
    """Of the end."""
    spin: Spin
    """Of the end."""
    cosine: Scalar
    """cos(theta/2)."""
    height: Scalar
    """H(theta) [m]."""
    bend_slope: tuple[tuple[Any, Any], tuple[Any, Any]]
    """Of the bend a of its joints, by each half angle."""
    bend: tuple[Any, Any]


@struct.dataclass
class _Joint:
    """What all joints of a segment share, in the frames of their lower plates."""

    sine: tuple[Any, Any]
    cosine: tuple[Any, Any]
    half: Vector
    """n."""
    turning: Vector
    """Angular velocity of the upper plate for a rate of x; that for y is twice the chord's."""
    drift: Vector
    """Angular acceleration of the upper plate."""
    chord_drift: Vector
    rates: tuple[Any, Any]


def segment_motion(arm: QuaternionArm, count: int, half_angles: Any, rates: Any) -> SegmentMotion:
    """A segment of `count` joints at half angles [rad] and rates [rad/s], pairs of (*batch)."""
    x, y = half_angles
    sine_x, sine_y, cosine_x, cosine_y = jnp.sin(x), jnp.sin(y), jnp.cos(x), jnp.cos(y)
    joint = _joint((sine_x, sine_y), (cosine_x, cosine_y), rates)
    cosine = _cosine(joint)
    height = _height(arm, cosine, rates)
    home_height = 0.5 * height_at(arm, jnp.ones((), sine_x.dtype))
    half_link = 0.5 * jnp.asarray(arm.link_length, sine_x.dtype)
    place, rotation, spin = Place(ZERO, (ZERO, ZERO), ZERO), IDENTITY, Spin((ZERO, ZERO), ZERO, ZERO)
    chords, links = [], []
    for _ in range(count):
        chord_spin, after = _spins(joint, rotation, spin)
        half = _turning(rotation.times(joint.half), chord_spin, rates)
        chords.append(Body(_beyond(place, home_height, half), half.at, chord_spin))
        plate = _raised(place, height, half, rates)
        rotation = _rolled(rotation, joint.half, half.at)
        spin = after
        axis = _turning(rotation.z, spin, rates)
        middle = _beyond(plate, half_link, axis)
        links.append(Body(middle, rotation.z, spin))
        place = _beyond(middle, half_link, axis)
    zero = jnp.zeros_like(sine_x)
    bend_slope = ((zero, -cosine.at), (cosine_y, sine_x * sine_y))
    return SegmentMotion(chords, links, place, rotation, spin, cosine, height, bend_slope, (sine_y, -sine_x * cosine_y))


def segment_motions(arm: QuaternionArm, half_angles: jax.Array, rates: jax.Array) -> dict[int, SegmentMotion]:
    """By number of joints: all segments of so many joints side by side, along a new first axis, at half angles and rates
    (segments, 2, *batch)."""
    return {
        count: segment_motion(
            arm,
            count,
            *(
                (jnp.stack([values[row, 0] for row in rows]), jnp.stack([values[row, 1] for row in rows]))
                for values in (half_angles, rates)
            ),
        )
        for count, rows in rows_by_count(arm).items()
    }


def rows_by_count(arm: QuaternionArm) -> dict[int, list[int]]:
    """Segments by their number of joints."""
    counts = arm.joints_per_segment
    return {count: [row for row, other in enumerate(counts) if other == count] for count in sorted(set(counts))}


def height_at(arm: QuaternionArm, cosine: jax.Array) -> jax.Array:
    """H(theta) [m] at cos(theta/2)."""
    crossed, pins, offset = _lengths(arm, cosine)
    return height_of_cosine(crossed, pins, offset, cosine)


def _joint(sine, cosine, rates) -> _Joint:
    """Lower hinges x, y, then upper y, x, whose axes lie where those before have turned them: e_x + Rx(x) Ry(2y) e_x and
    2 Rx(x) e_y."""
    (sine_x, sine_y), (cosine_x, cosine_y), (rate_x, rate_y) = sine, cosine, rates
    double_sine, double_cosine = 2.0 * sine_y * cosine_y, 2.0 * cosine_y * cosine_y - 1.0
    turning = Vector(1.0 + double_cosine, sine_x * double_sine, -cosine_x * double_sine)
    mixed = times(rate_x, rate_y)
    square = times(rate_x, rate_x)
    by_x = Vector(0.0, -turning.z, turning.y).scaled(square)
    by_y = Vector(-2.0 * double_sine, 2.0 * sine_x * double_cosine, -2.0 * cosine_x * double_cosine).scaled(mixed)
    chord_drift = Vector(0.0, -sine_x, cosine_x).scaled(mixed)
    return _Joint(
        sine,
        cosine,
        Vector(sine_y, -sine_x * cosine_y, cosine_x * cosine_y),
        turning,
        by_x + by_y + chord_drift + chord_drift,
        chord_drift,
        rates,
    )


def _cosine(joint: _Joint) -> Scalar:
    (sine_x, sine_y), (cosine_x, cosine_y), (rate_x, rate_y) = joint.sine, joint.cosine, joint.rates
    squares = add(times(rate_x, rate_x), times(rate_y, rate_y))
    mixed = times(2.0, times(rate_x, rate_y))
    drift = vectors.subtract(times(sine_x * sine_y, mixed), times(joint.half.z, squares))
    return Scalar(joint.half.z, (-sine_x * cosine_y, -cosine_x * sine_y), drift)


def _height(arm: QuaternionArm, cosine: Scalar, rates) -> Scalar:
    """By the chain rule through cos(theta/2)."""
    crossed, pins, offset = _lengths(arm, cosine.at)
    root = (crossed**2 - (pins * cosine.at) ** 2) ** 0.5
    first = 2.0 * offset - pins**2 * cosine.at / root
    second = -((crossed * pins) ** 2) / (root * root * root)
    speed = _at(cosine.slope, rates)
    drift = add(times(second, times(speed, speed)), times(first, cosine.drift))
    slope = (first * cosine.slope[0], first * cosine.slope[1])
    return Scalar(root + 2.0 * offset * cosine.at, slope, drift)


def _spins(joint: _Joint, rotation: Matrix, spin: Spin) -> tuple[Spin, Spin]:
    """Of the chord and of the upper plate that follow a plate."""
    (sine_x, _), (cosine_x, _), rates = joint.sine, joint.cosine, joint.rates
    second = rotation.y.scaled(cosine_x) + rotation.z.scaled(sine_x)  # R Rx(x) e_y
    chord_y = spin.slope[1] + second

    def turning(slope: tuple[Vector, Vector], drift: Vector) -> Spin:
        rate = _vector_at(slope, rates)
        return Spin(slope, rate, spin.drift + spin.rate.cross(rate) + rotation.times(drift))

    after = (spin.slope[0] + rotation.times(joint.turning), chord_y + second)
    return turning((spin.slope[0] + rotation.x, chord_y), joint.chord_drift), turning(after, joint.drift)


def _turning(axis: Vector, spin: Spin, rates) -> Place:
    """A unit vector that turns with a body."""
    slope = (spin.slope[0].cross(axis), spin.slope[1].cross(axis))
    return Place(axis, slope, spin.drift.cross(axis) + spin.rate.cross(_vector_at(slope, rates)))


def _beyond(place: Place, length: Any, axis: Place) -> Place:
    """At a constant length along an axis."""
    slope = (place.slope[0] + axis.slope[0].scaled(length), place.slope[1] + axis.slope[1].scaled(length))
    return Place(place.at + axis.at.scaled(length), slope, place.drift + axis.drift.scaled(length))


def _raised(place: Place, height: Scalar, axis: Place, rates) -> Place:
    """At a joint's height along an axis."""
    moved = _beyond(place, height.at, axis)
    slope = (moved.slope[0] + axis.at.scaled(height.slope[0]), moved.slope[1] + axis.at.scaled(height.slope[1]))
    twice = times(2.0, _at(height.slope, rates))
    return Place(
        moved.at,
        slope,
        moved.drift + axis.at.scaled(height.drift) + _vector_at(axis.slope, rates).scaled(twice),
    )


def _rolled(rotation: Matrix, n: Vector, turned: Vector) -> Matrix:
    """Columns times Rot(n, pi) Rot(z, pi) (Eq. 2 of paper 000), `turned` being n in their frame."""
    return Matrix(
        rotation.x - turned.scaled(2.0 * n.x),
        rotation.y - turned.scaled(2.0 * n.y),
        turned.scaled(2.0 * n.z) - rotation.z,
    )


def _at(slope, rates):
    return add(times(slope[0], rates[0]), times(slope[1], rates[1]))


def _vector_at(slope, rates) -> Vector:
    return slope[0].scaled(rates[0]) + slope[1].scaled(rates[1])


def _lengths(arm: QuaternionArm, cosine: jax.Array) -> tuple:
    return tuple(
        jnp.asarray(length, cosine.dtype) for length in (arm.crossed_link_length, arm.pin_distance, arm.plate_to_pin)
    )
