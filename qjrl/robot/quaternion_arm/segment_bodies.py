"""The bodies of a segment taken together, in the frame of its base: moments, momenta, and the force that moves them.

A chord is a capsule and a link a cylinder, so inertia is `across` + (`along` - `across`) z z^T, and only the axis z counts.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from flax import struct

from qjrl.geometry.vectors import ZERO, Matrix, Symmetric, Vector, add, square, times
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.joint import height_of_cosine
from qjrl.robot.quaternion_arm.mjcf import CHORD_RADIUS
from qjrl.robot.quaternion_arm.segment_shape import Body, SegmentMotion


class _Kind(NamedTuple):
    """What all chords, or all links, share."""

    mass: Any
    across: Any
    along: Any


@struct.dataclass
class SegmentInertia:
    """About the segment's base."""

    first: Vector
    """First moment [kg m]."""
    second: Symmetric
    """Second moments sum m c c^T, a body's own included [kg m^2]; angular inertia is their trace less them."""
    linear: tuple[Vector, Vector]
    """Momentum for a rate of each half angle."""
    angular: tuple[Vector, Vector]
    own: tuple[Any, Any, Any]
    """Entries xx, xy, yy of the mass matrix."""


@struct.dataclass
class Carried:
    """Motion of the segment's base, in its frame; gravity is an acceleration upwards."""

    turned: Vector
    """[rad/s]."""
    turned_rate: Vector
    """[rad/s^2]."""
    moved: Vector
    """[m/s^2]."""


@struct.dataclass
class SegmentForce:
    """What it takes to move the bodies as they move at constant rates, about the segment's base."""

    linear: Vector
    angular: Vector
    own: tuple[Any, Any]
    """For each half angle."""


def segment_mass(arm: QuaternionArm, count: int) -> Any:
    """[kg]."""
    return count * (arm.joint_mass + arm.link_mass)


def segment_inertia(arm: QuaternionArm, motion: SegmentMotion) -> SegmentInertia:
    """Moments and momenta of a segment's bodies."""
    first, linear, angular, own = ZERO, [ZERO, ZERO], [ZERO, ZERO], [0.0, 0.0, 0.0]
    second = Symmetric(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for kind, bodies in _kinds(arm, motion):
        centres = _total(body.centre.at for body in bodies)
        first = first + centres.scaled(kind.mass)
        spread = _all(square(body.centre.at, body.centre.at.scaled(kind.mass)) for body in bodies)
        shape = _all(square(body.axis, body.axis.scaled(kind.across - kind.along)) for body in bodies)
        ball = 0.5 * kind.along * len(bodies)
        second = second + spread + shape + Symmetric(ball, 0.0, 0.0, ball, 0.0, ball)
        leans = [[body.axis.dot(body.spin.slope[k]) for k in range(2)] for body in bodies]
        for k in range(2):
            linear[k] = linear[k] + _total(body.centre.slope[k] for body in bodies).scaled(kind.mass)
            orbit = _total(body.centre.at.cross(body.centre.slope[k]) for body in bodies).scaled(kind.mass)
            round_axis = _total(body.axis.scaled(lean[k]) for body, lean in zip(bodies, leans, strict=True))
            spin = _total(body.spin.slope[k] for body in bodies).scaled(kind.across)
            angular[k] = angular[k] + orbit + spin + round_axis.scaled(kind.along - kind.across)
        for place, (j, k) in enumerate(((0, 0), (0, 1), (1, 1))):
            moved = _sum(body.centre.slope[j].dot(body.centre.slope[k]) for body in bodies)
            turned = _sum(body.spin.slope[j].dot(body.spin.slope[k]) for body in bodies)
            along = _sum(times(lean[j], lean[k]) for lean in leans)
            for weight, value in ((kind.mass, moved), (kind.across, turned), (kind.along - kind.across, along)):
                own[place] = add(own[place], times(weight, value))
    return SegmentInertia(first, second, (linear[0], linear[1]), (angular[0], angular[1]), (own[0], own[1], own[2]))


def segment_force(arm: QuaternionArm, motion: SegmentMotion, rates: tuple[Any, Any], carried: Carried) -> SegmentForce:
    """Newton and Euler for a segment's bodies at constant rates of its half angles, pairs of (*batch)."""
    swing, turned = _swing(carried), carried.turned
    linear, angular, own = ZERO, ZERO, [0.0, 0.0]
    for kind, bodies in _kinds(arm, motion):
        for body in bodies:
            centre = body.centre
            speed = centre.slope[0].scaled(rates[0]) + centre.slope[1].scaled(rates[1])
            moved = carried.moved + centre.drift + swing.times(centre.at) + turned.cross(speed + speed)
            pull = moved.scaled(kind.mass)
            twist = _twist(kind, body, carried)
            linear = linear + pull
            angular = angular + centre.at.cross(pull) + twist
            own = [add(own[k], add(centre.slope[k].dot(pull), body.spin.slope[k].dot(twist))) for k in range(2)]
    return SegmentForce(linear, angular, (own[0], own[1]))


def _twist(kind: _Kind, body: Body, carried: Carried) -> Vector:
    """Rate of a body's angular momentum about its centre."""
    spin, axis = carried.turned + body.spin.rate, body.axis
    spin_rate = carried.turned_rate + body.spin.drift + carried.turned.cross(body.spin.rate)
    about = axis.scaled(axis.dot(spin_rate)) + spin.cross(axis).scaled(axis.dot(spin))
    return spin_rate.scaled(kind.across) + about.scaled(kind.along - kind.across)


def _swing(carried: Carried) -> Matrix:
    """Acceleration of a point that the base carries, as a matrix: alpha x + omega (omega .) - |omega|^2."""
    w, a = carried.turned, carried.turned_rate
    pairs = square(w, w)
    return Matrix(
        Vector(-(pairs.yy + pairs.zz), pairs.xy + a.z, pairs.xz - a.y),
        Vector(pairs.xy - a.z, -(pairs.xx + pairs.zz), pairs.yz + a.x),
        Vector(pairs.xz + a.y, pairs.yz - a.x, -(pairs.xx + pairs.yy)),
    )


def _kinds(arm: QuaternionArm, motion: SegmentMotion) -> list[tuple[_Kind, list[Body]]]:
    home_height = height_of_cosine(arm.crossed_link_length, arm.pin_distance, arm.plate_to_pin, 1.0)
    chord = _capsule_inertia(arm.joint_mass, CHORD_RADIUS * arm.link_radius, home_height)
    link = _cylinder_inertia(arm.link_mass, arm.link_radius, arm.link_length)
    return [(_Kind(arm.joint_mass, *chord), motion.chords), (_Kind(arm.link_mass, *link), motion.links)]


def _cylinder_inertia(mass: Any, radius: Any, length: Any) -> tuple[Any, Any]:
    """Across and along its axis [kg m^2]."""
    length = jnp.maximum(length, 0.002)  # as in the MJCF
    return mass * (3.0 * radius**2 + length**2) / 12.0, 0.5 * mass * radius**2


def _capsule_inertia(mass: Any, radius: Any, length: Any) -> tuple[Any, Any]:
    """A cylinder and two half balls of one density."""
    cylinder = mass * length / (length + 4.0 * radius / 3.0)
    balls = mass - cylinder
    across, along = _cylinder_inertia(cylinder, radius, length)
    shift = 0.5 * length * (0.5 * length + 0.75 * radius)  # the half balls' centres lie 3/8 of the radius outside
    return across + balls * (0.4 * radius**2 + shift), along + 0.4 * balls * radius**2


def _total(vectors) -> Vector:
    return sum(vectors, start=ZERO)


def _all(matrices) -> Symmetric:
    return sum(matrices, start=Symmetric(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def _sum(values) -> Any:
    total = 0.0
    for value in values:
        total = add(total, value)
    return total
