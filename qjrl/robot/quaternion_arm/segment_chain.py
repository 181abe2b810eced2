"""Segments one after the other, in the base frame: mass matrix and forces of the whole arm.

Momenta, forces and moments are about the origin of the base frame, where those of several bodies simply add up: what a
coordinate does to all that lies beyond its segment is a turn and a velocity of the origin, the same for all of it.
Fields of a `Chain` have the segments first and a batch of arms last.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.geometry.vectors import IDENTITY, ZERO, Matrix, Symmetric, Vector, add, both_ways, square, times
from qjrl.robot.plant import PAYLOAD_RADIUS
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.mjcf import SLIDE_ARMATURE
from qjrl.robot.quaternion_arm.segment_bodies import (
    Carried,
    SegmentForce,
    SegmentInertia,
    segment_force,
    segment_inertia,
    segment_mass,
)
from qjrl.robot.quaternion_arm.segment_shape import SegmentMotion, rows_by_count


@struct.dataclass
class Load:
    """What may differ between arms of one description; trailing axes are those of the batch, or none."""

    gravity: Any
    """(3, *batch) [m/s^2]."""
    armature_scale: Any
    """(*batch) times the armatures as described."""
    payload: Any
    """(*batch) mass at the tip [kg]."""


@struct.dataclass
class Chain:
    """All segments in the base frame."""

    rotation: Matrix
    """Of each base."""
    place: Vector
    """Of each base [m]."""
    end: Vector
    """Of each end [m]."""
    carried: Carried
    """In each base's own frame."""
    turning: tuple[Vector, Vector]
    """Angular velocity of each end for a rate of its half angles."""
    origin: tuple[Vector, Vector]
    """Velocity of the base frame's origin, if it were fixed to the end, for a rate of its half angles."""
    tip: "_Beyond"
    """What hangs on the last end."""


@struct.dataclass
class _Beyond:
    """Bodies, and the force and moment that move them at constant rates, about the origin."""

    mass: Any
    first: Vector
    second: Symmetric
    force: Vector
    moment: Vector


def in_order(arm: QuaternionArm, groups: dict[int, Any], like: jax.Array) -> Any:
    """Trees of segments of equally many joints as one tree of all segments; `like` has the shape of one number."""
    places = {segment: (count, k) for count, rows in rows_by_count(arm).items() for k, segment in enumerate(rows)}
    if len(groups) == 1:
        return jax.tree.map(lambda value: filled(value, jnp.stack([like] * arm.num_segments)), *groups.values())
    return stacked([row(groups[places[k][0]], places[k][1]) for k in range(arm.num_segments)], like)


def chain_of(load: Load, motion: SegmentMotion, rates: jax.Array) -> Chain:
    """From segments in their own frames, one after the other from the base."""
    like, count = jnp.zeros_like(rates[0, 0]), len(rates)
    rotation, rotations = IDENTITY, []
    for k in range(count):
        rotations.append(rotation)
        rotation = rotation.product(row(motion.rotation, k))
    frame = stacked(rotations, like)
    pair = (rates[:, 0], rates[:, 1])
    speed = motion.end.slope[0].scaled(pair[0]) + motion.end.slope[1].scaled(pair[1])
    seen = [frame.times(v) for v in (motion.end.at, speed, motion.end.drift, motion.spin.rate, motion.spin.drift)]
    place, turned, turned_rate = ZERO, ZERO, ZERO
    moved = Vector(*(-load.gravity[k] for k in range(3)))
    places, bases = [], []
    for k in range(count):
        places.append(place)
        bases.append((turned, turned_rate, moved))
        end, end_rate, end_drift, spin, spin_rate = (row(value, k) for value in seen)
        moved = moved + end_drift + turned_rate.cross(end) + turned.cross(turned.cross(end) + end_rate + end_rate)
        turned_rate = turned_rate + turned.cross(spin) + spin_rate
        turned, place = turned + spin, place + end
    carried = Carried(*(frame.transposed_times(stacked(list(values), like)) for values in zip(*bases, strict=True)))
    ends = stacked([*places[1:], place], like)
    turning = (frame.times(motion.spin.slope[0]), frame.times(motion.spin.slope[1]))
    origin = (
        frame.times(motion.end.slope[0]) + ends.cross(turning[0]),
        frame.times(motion.end.slope[1]) + ends.cross(turning[1]),
    )
    tip = _payload(load, place, moved, turned_rate)
    return Chain(frame, stacked(places, like), ends, carried, turning, origin, tip)


def mass_and_force(
    arm: QuaternionArm, load: Load, motions: dict[int, SegmentMotion], motion: SegmentMotion, rates: jax.Array
) -> tuple[list[list[Any]], list[Any]]:
    """Mass matrix [kg m^2] and force of gravity and Coriolis [N m], entries (*batch); coordinates segment by segment.

    Args:
        motions: by number of joints, as `segment_motions` gives them.
        motion: the same `in_order`, without bodies.
    """
    like = jnp.zeros_like(rates[0, 0])
    chain = chain_of(load, motion, rates)
    inertia = in_order(arm, {count: segment_inertia(arm, part) for count, part in motions.items()}, like)
    forces = {}
    for count, rows in rows_by_count(arm).items():
        pair, carried = of_rows(((rates[:, 0], rates[:, 1]), chain.carried), rows)
        forces[count] = segment_force(arm, motions[count], pair, carried)
    force = in_order(arm, forces, like)
    weights = [segment_mass(arm, count) for count in arm.joints_per_segment]
    mass = jnp.asarray(weights, like.dtype).reshape(-1, *[1] * like.ndim)
    linear = [chain.rotation.times(value) for value in inertia.linear]
    angular = [
        chain.rotation.times(value) + chain.place.cross(momentum)
        for value, momentum in zip(inertia.angular, linear, strict=True)
    ]
    beyond = _beyond(chain, _in_base_frame(chain, inertia, force, mass), weights, like)
    for_rate = [_momentum(beyond, chain.turning[k], chain.origin[k]) for k in range(2)]
    own = dict(zip(((0, 0), (0, 1), (1, 1)), inertia.own, strict=True))
    for (j, k), value in own.items():
        slide = times(_slides(arm, load, like), motion.height.slope[j] * motion.height.slope[k])
        own[j, k] = add(value + _does(chain, j, *for_rate[k]), slide)
    for k in range(2):  # two hinges of a joint turn with a coordinate
        armature = 2.0 * jnp.asarray(arm.armature, like.dtype) * jnp.asarray(arm.joints_per_segment, like.dtype)
        own[k, k] = own[k, k] + armature.reshape(-1, *[1] * like.ndim) * load.armature_scale
    all_beyond = [(for_rate[k][0] + linear[k], for_rate[k][1] + angular[k]) for k in range(2)]
    pull = []
    for k in range(2):
        slide = times(_slides(arm, load, like), motion.height.slope[k] * motion.height.drift)
        pull.append(-add(force.own[k] + _does(chain, k, beyond.force, beyond.moment), slide))
    entries = _entries(chain, own, all_beyond, arm.num_segments)
    return entries, [row(pull[k % 2], k // 2) for k in range(2 * arm.num_segments)]


def _entries(chain: Chain, own, momenta, count: int) -> list[list[Any]]:
    """Of the mass matrix: a segment's own, and of every segment with the `apart`-th after it."""
    size = 2 * count
    entries: list[list] = [[None] * size for _ in range(size)]

    def put(values, j: int, k: int, apart: int) -> None:
        for segment in range(count - apart):
            a, b = 2 * segment + j, 2 * (segment + apart) + k
            entries[a][b] = entries[b][a] = row(values, segment)

    for (j, k), values in own.items():
        put(values, j, k, 0)
    for apart in range(1, count):
        for k in range(2):
            linear, angular = (_cut(value, apart, count) for value in momenta[k])
            for j in range(2):
                turning, origin = (_cut(value[j], 0, count - apart) for value in (chain.turning, chain.origin))
                put(turning.dot(angular) + origin.dot(linear), j, k, apart)
    return entries


def _does(chain: Chain, coordinate: int, linear: Vector, angular: Vector) -> Any:
    """What momenta, or force and moment, about the origin do for a half angle of each segment."""
    return chain.turning[coordinate].dot(angular) + chain.origin[coordinate].dot(linear)


def _momentum(bodies: _Beyond, turning: Vector, origin: Vector) -> tuple[Vector, Vector]:
    """Of bodies held together, about the origin."""
    linear = origin.scaled(bodies.mass) + turning.cross(bodies.first)
    angular = bodies.first.cross(origin) + turning.scaled(bodies.second.trace()) - bodies.second.times(turning)
    return linear, angular


def _in_base_frame(chain: Chain, inertia: SegmentInertia, force: SegmentForce, mass: jax.Array) -> _Beyond:
    """Each segment's own bodies about the origin."""
    place, first = chain.place, chain.rotation.times(inertia.first)
    whole = place.scaled(mass)
    second = inertia.second.turned(chain.rotation) + both_ways(place, first) + square(place, whole)
    linear = chain.rotation.times(force.linear)
    moment = chain.rotation.times(force.angular) + place.cross(linear)
    return _Beyond(mass, first + whole, second, linear, moment)


def _beyond(chain: Chain, own: _Beyond, weights: list[Any], like: jax.Array) -> _Beyond:
    """All that lies beyond each segment's end."""
    found = [chain.tip]
    for k in reversed(range(1, len(weights))):
        found.append(jax.tree.map(add, found[-1], dataclasses.replace(row(own, k), mass=weights[k])))
    return stacked(found[::-1], like)


def _payload(load: Load, place: Vector, moved: Vector, turned_rate: Vector) -> _Beyond:
    """A ball: half its inertia is the weight of each axis."""
    weight = 0.2 * PAYLOAD_RADIUS**2 * load.payload
    first, force = place.scaled(load.payload), moved.scaled(load.payload)
    second = square(place, first) + Symmetric(weight, 0.0, 0.0, weight, 0.0, weight)
    return _Beyond(load.payload, first, second, force, place.cross(force) + turned_rate.scaled(2.0 * weight))


def _slides(arm: QuaternionArm, load: Load, like: jax.Array) -> Any:
    """Added mass of the slides of each segment's joints [kg]; none where the height is constant."""
    if arm.joint_model != "rolling":
        return 0.0
    armature = jnp.asarray([SLIDE_ARMATURE * count for count in arm.joints_per_segment], like.dtype)
    return armature.reshape(-1, *[1] * like.ndim) * load.armature_scale


def row(tree: Any, place: int) -> Any:
    """One segment of a tree whose arrays have the segments first."""
    return jax.tree.map(lambda v: v if isinstance(v, float) else jax.lax.index_in_dim(v, place, 0, False), tree)


def of_rows(tree: Any, rows: list[int]) -> Any:
    """Some segments of a tree whose arrays have all segments first."""
    if all(len(leaf) == len(rows) for leaf in jax.tree.leaves(tree)):
        return tree
    return jax.tree.map(lambda value: jnp.stack([value[place] for place in rows]), tree)


def stacked(trees: list[Any], like: jax.Array) -> Any:
    """Trees of one number an arm, or of Python numbers, along a new first axis."""
    return jax.tree.map(lambda *values: jnp.stack([filled(value, like) for value in values]), *trees)


def filled(value: Any, like: jax.Array) -> jax.Array:
    """In the shape of `like`."""
    return jnp.broadcast_to(jnp.asarray(value, like.dtype), like.shape)


def _cut(vector: Vector, first: int, last: int) -> Vector:
    return jax.tree.map(lambda value: jax.lax.slice_in_dim(value, first, last), vector)
