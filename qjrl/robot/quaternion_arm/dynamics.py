"""Equations of motion in minimal coordinates: the half angles (x, y) of each segment's joints, two numbers a segment.

All joints of a segment share them: what the physics of `mjcf` ties together with equality rows is one coordinate here.
Forces come from recursive Newton-Euler, the mass matrix from composite bodies, both from segment to segment.

A rigid body counts as four weighted points (`segment_shape`): its centre, weighted by the mass, and the tips of its axes,
weighted by c_i = tr(I)/2 - I_ii. Then sum w |dz/dt|^2 is twice its kinetic energy, and bodies need no angular velocity.
Components come first and a batch of arms last, as in `geometry.lanes`.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.geometry import lanes
from qjrl.robot.quaternion_arm.cables import cable_matrix
from qjrl.robot.quaternion_arm.description import QuaternionArm
from qjrl.robot.quaternion_arm.joint import height_of_cosine
from qjrl.robot.quaternion_arm.mjcf import CHORD_RADIUS, PAYLOAD_RADIUS, SLIDE_ARMATURE
from qjrl.robot.quaternion_arm.segment_shape import (
    SegmentMotion,
    height_at,
    segment_motions,
    segment_shape,
)


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
class Equations:
    """mass (d rates / dt) = force + springs, dampers, strands; coordinates segment by segment, x before y."""

    mass: jax.Array
    """(coordinates, coordinates, *batch) [kg m^2]."""
    force: jax.Array
    """(coordinates, *batch) of gravity and Coriolis [N m]."""
    strands: jax.Array
    """(strands, *batch) lengths inside the joints, as `cables.strand_lengths` [m]."""
    strand_slope: jax.Array
    """(coordinates, strands, *batch) [m/rad]."""
    cosines: jax.Array
    """(segments, *batch) cos(theta/2), which falls as the joints bend."""
    cosine_slope: jax.Array
    """(coordinates, segments, *batch)."""


def equations_of_motion(arm: QuaternionArm, load: Load, half_angles: jax.Array, rates: jax.Array) -> Equations:
    """At half angles [rad] and rates [rad/s], both (segments, 2, *batch)."""
    segments = segment_motions(arm, half_angles, rates)
    strands, strand_slope = _strands(arm, segments)
    cosines, slopes = (
        jnp.stack(values) for values in zip(*((s.at.cosine, s.slope.cosine) for s in segments), strict=True)
    )
    cosine_slope = [_only(slopes[k // 2, k % 2], k // 2, len(segments)) for k in range(2 * len(segments))]
    return Equations(
        _mass_matrix(arm, load, segments),
        _force(arm, load, segments, rates),
        strands,
        strand_slope,
        cosines,
        jnp.stack(cosine_slope),
    )


def tip_pose(arm: QuaternionArm, half_angles: jax.Array) -> jax.Array:
    """Pose (9, *batch) [m, -] of the tip at half angles (segments, 2, *batch) [rad]."""
    shapes = [segment_shape(arm, count, pair) for count, pair in zip(arm.joints_per_segment, half_angles, strict=True)]
    position, rotation = shapes[0].end, shapes[0].rotation
    for shape in shapes[1:]:
        position = position + lanes.times(rotation, shape.end)
        rotation = lanes.product(rotation, shape.rotation)
    return jnp.concatenate([position, rotation[:, 0], rotation[:, 1]])


def joint_coordinates(arm: QuaternionArm, half_angles: jax.Array) -> jax.Array:
    """Joint positions (nq, *batch) of the MJCF at half angles (segments, 2, *batch): hinges [rad] and slides [m]."""
    x, y = half_angles[:, 0], half_angles[:, 1]
    slides = height_at(arm, jnp.cos(x) * jnp.cos(y)) - height_at(arm, jnp.ones((), x.dtype))
    joint = jnp.stack([x, y, slides, y, x] if arm.joint_model == "rolling" else [x, y, y, x], axis=1)
    return jnp.concatenate([joint[k] for k, count in enumerate(arm.joints_per_segment) for _ in range(count)])


def hinge_stiffness(arm: QuaternionArm) -> np.ndarray:
    """(coordinates,) [N m/rad]: four hinges of a joint carry 1/2 K theta^2 together."""
    return np.repeat(4.0 * arm.config.mechanics.joint_stiffness * np.array(arm.joints_per_segment), 2)


def hinge_damping(arm: QuaternionArm) -> np.ndarray:
    """(coordinates,) [N m s/rad]."""
    return np.repeat(4.0 * arm.config.mechanics.joint_damping * np.array(arm.joints_per_segment), 2)


@struct.dataclass
class _Wrench:
    """Force and moment, or momenta, of all that lies beyond a point, about that point; (3, *batch)."""

    linear: jax.Array
    angular: jax.Array

    def turned(self, rotation: jax.Array) -> "_Wrench":
        return _Wrench(lanes.times(rotation, self.linear), lanes.times(rotation, self.angular))

    def moved(self, arm: jax.Array) -> "_Wrench":
        """About the point that lies `arm` before."""
        return _Wrench(self.linear, self.angular + lanes.cross(arm, self.linear))

    def along(self, segment: SegmentMotion, coordinate: int) -> jax.Array:
        """What it does at a segment's end for one of its half angles."""
        return lanes.dot(self.linear, segment.slope.end[coordinate]) + lanes.dot(
            self.angular, segment.at.turning[:, coordinate]
        )

    def plus_points(self, points: jax.Array, pulls: jax.Array) -> "_Wrench":
        """With pulls (3, points, *batch) at weighted points; axes have none but a moment."""
        return _Wrench(
            self.linear + jnp.sum(pulls[:, ::4], axis=1), self.angular + jnp.sum(lanes.cross(points, pulls), axis=1)
        )


def _force(arm: QuaternionArm, load: Load, segments: list[SegmentMotion], rates: jax.Array) -> jax.Array:
    """Recursive Newton-Euler at constant rates.

    Outward go angular velocity, angular acceleration and acceleration of each segment's base, in its own frame, gravity
    being an acceleration of the first base; inward go forces and moments.
    """
    turned = turned_rate = jnp.zeros_like(segments[0].at.end)
    moved, pulls = turned - load.gravity, []
    for segment, rate in zip(segments, rates, strict=True):
        at, speed, drift = segment.at, segment.rate, segment.drift
        weights = _weights(arm, segment)
        local = _seen_from_rest(turned[:, None], turned_rate[:, None], at.points, speed.points, drift.points)
        pulls.append(weights * local.at[:, ::4].add(moved[:, None]))
        end = moved + _seen_from_rest(turned, turned_rate, at.end, speed.end, drift.end)
        spin = lanes.times(at.turning, rate)
        spin_rate = lanes.cross(turned, spin) + lanes.times(speed.turning, rate)
        back = jnp.swapaxes(at.rotation, 0, 1)
        turned, turned_rate, moved = (
            lanes.times(back, value) for value in (turned + spin, turned_rate + spin_rate, end)
        )
    beyond = _Wrench(load.payload * moved, 2.0 * _ball_weight(load) * turned_rate)
    forces = []
    for segment, pull in zip(segments[::-1], pulls[::-1], strict=True):
        outer = beyond.turned(segment.at.rotation)
        slide = _slide_armature(arm, load, segment) * segment.drift.height
        for k in (1, 0):
            own = jnp.sum(segment.slope.points[k] * pull, axis=(0, 1)) + segment.slope.height[k] * slide
            forces.append(-own - outer.along(segment, k))
        beyond = outer.moved(segment.at.end).plus_points(segment.at.points, pull)
    return jnp.stack(forces[::-1])


def _mass_matrix(arm: QuaternionArm, load: Load, segments: list[SegmentMotion]) -> jax.Array:
    """Composite bodies: the momentum that a coordinate's rate gives all beyond it, seen by the coordinates before.

    What hangs on a segment's end is a mass, a first moment and a matrix of second moments of weighted points.
    """
    size = 2 * len(segments)
    entries: list[list] = [[None] * size for _ in range(size)]
    mass, first = load.payload, jnp.zeros_like(segments[0].at.end)
    second = _ball_weight(load) * lanes.identity_like(segments[0].at.rotation)
    for index in reversed(range(len(segments))):
        segment, at, slope = segments[index], segments[index].at, segments[index].slope
        weights = _weights(arm, segment)
        first = lanes.times(at.rotation, first)
        second = lanes.product(lanes.product(at.rotation, second), jnp.swapaxes(at.rotation, 0, 1))
        for k in range(2):
            momenta = weights * slope.points[k]
            wrench = _momentum(mass, first, second, slope.end[k], at.turning[:, k])
            for j in range(k + 1):
                slide = _slide_armature(arm, load, segment) * slope.height[k] * slope.height[j]
                own = jnp.sum(slope.points[j] * momenta, axis=(0, 1)) + slide
                entries[2 * index + j][2 * index + k] = own + wrench.along(segment, j)
            wrench = wrench.moved(at.end).plus_points(at.points, momenta)
            for before in reversed(range(index)):
                wrench = wrench.turned(segments[before].at.rotation)
                for j in range(2):
                    entries[2 * before + j][2 * index + k] = wrench.along(segments[before], j)
                wrench = wrench.moved(segments[before].at.end)
        mass, first, second = _together(mass, first, second, at, weights)
    for row in range(size):  # two hinges of a joint turn with a coordinate
        armature = 2.0 * arm.joints_per_segment[row // 2] * arm.config.mechanics.armature
        entries[row][row] = entries[row][row] + armature * load.armature_scale
    return jnp.stack([jnp.stack([entries[min(i, j)][max(i, j)] for j in range(size)]) for i in range(size)])


def _momentum(mass, first, second, velocity, turning) -> _Wrench:
    """Of bodies held together, about a point that moves and about which they turn."""
    trace = second[0, 0] + second[1, 1] + second[2, 2]
    angular = lanes.cross(first, velocity) + trace * turning - lanes.times(second, turning)
    return _Wrench(mass * velocity + lanes.cross(turning, first), angular)


def _together(mass, first, second, at, weights):
    """Mass and moments about a segment's base of its own points and of what hangs on its end."""
    points, end = at.points, at.end
    own = weights * points
    cross = _outer(first, end)
    moments = jnp.sum(own[:, None] * points[None], axis=2) + second + cross + jnp.swapaxes(cross, 0, 1)
    second = moments + mass * _outer(end, end)
    first = first + mass * end + jnp.sum(own[:, ::4], axis=1)
    return mass + jnp.sum(weights[::4]), first, second


def _strands(arm: QuaternionArm, segments: list[SegmentMotion]) -> tuple[jax.Array, jax.Array]:
    """Lengths and slopes: half differences are linear in the bends, means the sum of the heights of the joints crossed."""
    matrix = cable_matrix(arm).astype(segments[0].at.height.dtype).reshape(arm.num_cables, -1, 2)
    counts = arm.joints_per_segment

    def of(shapes, crossed: list[int], cable: int) -> tuple:
        common = sum(counts[j] * shapes[j].height for j in crossed)
        difference = sum(
            matrix[cable, j, 0] * shapes[j].bend[0] + matrix[cable, j, 1] * shapes[j].bend[1] for j in crossed
        )
        return common + difference, common - difference

    shapes = [segment.at for segment in segments]
    lengths = [one for cable in range(arm.num_cables) for one in of(shapes, list(range(cable // 2 + 1)), cable)]
    zero, slopes = jnp.zeros_like(lengths[0]), []
    for coordinate in range(2 * len(segments)):
        moved = [jax.tree.map(lambda value, k=coordinate % 2: value[k], segment.slope) for segment in segments]
        own = coordinate // 2
        pairs = (of(moved, [own], cable) if cable // 2 >= own else (zero, zero) for cable in range(arm.num_cables))
        slopes.append(jnp.stack([one for pair in pairs for one in pair]))
    return jnp.stack(lengths), jnp.stack(slopes)


def _weights(arm: QuaternionArm, segment: SegmentMotion) -> jax.Array:
    """(points, 1 ...) masses [kg] and axis weights [kg m^2] of a segment's points."""
    mechanics, joint, points = arm.config.mechanics, arm.config.joint, segment.at.points
    home_height = height_of_cosine(joint.crossed_link_length, joint.pin_distance, joint.plate_to_pin, 1.0)
    chord = _capsule_inertia(mechanics.joint_mass, CHORD_RADIUS * mechanics.link_radius, home_height)
    link = _cylinder_inertia(mechanics.link_mass, mechanics.link_radius, arm.config.link_length)
    once = [mechanics.joint_mass, *_axis_weights(*chord), mechanics.link_mass, *_axis_weights(*link)]
    weights = jnp.asarray(once * (points.shape[1] // len(once)), points.dtype)
    return weights.reshape(-1, *[1] * (points.ndim - 2))


def _slide_armature(arm: QuaternionArm, load: Load, segment: SegmentMotion) -> jax.Array:
    """Added mass of the slides of a segment's joints [kg]; none where the height is constant."""
    count = segment.at.points.shape[1] // 8
    return SLIDE_ARMATURE * count * (arm.joint_model == "rolling") * load.armature_scale


def _axis_weights(across: float, along: float) -> list[float]:
    """Weights of the axes of a body with inertia `across` its axis z and `along` it [kg m^2]."""
    return [0.5 * along, 0.5 * along, across - 0.5 * along]


def _cylinder_inertia(mass: float, radius: float, length: float) -> tuple[float, float]:
    length = max(length, 0.002)  # as in the MJCF
    return mass * (3.0 * radius**2 + length**2) / 12.0, 0.5 * mass * radius**2


def _capsule_inertia(mass: float, radius: float, length: float) -> tuple[float, float]:
    """A cylinder and two half balls of one density."""
    cylinder = mass * length / (length + 4.0 * radius / 3.0)
    balls = mass - cylinder
    across, along = _cylinder_inertia(cylinder, radius, length)
    shift = 0.5 * length * (0.5 * length + 0.75 * radius)  # the half balls' centres lie 3/8 of the radius outside
    return across + balls * (0.4 * radius**2 + shift), along + 0.4 * balls * radius**2


def _ball_weight(load: Load) -> jax.Array:
    """Weight of each axis of the payload, a ball: half its inertia [kg m^2]."""
    return 0.2 * PAYLOAD_RADIUS**2 * load.payload


def _seen_from_rest(turned, turned_rate, place, speed, drift):
    """Acceleration of a place in a frame that turns, without that of the frame's origin."""
    return drift + lanes.cross(turned_rate, place) + lanes.cross(turned, lanes.cross(turned, place) + 2.0 * speed)


def _only(value: jax.Array, place: int, size: int) -> jax.Array:
    """(size, *batch) zeros but for one row."""
    return jnp.stack([value if row == place else jnp.zeros_like(value) for row in range(size)])


def _outer(a, b):
    return a[:, None] * b[None]
