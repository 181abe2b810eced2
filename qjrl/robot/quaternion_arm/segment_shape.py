"""One segment in the frame of its base: where its bodies are at the half angles of its joints, and how they move.

The half angles (x, y) of a joint are those of the MJCF's lower hinges: n = Rx(x) Ry(y) e_z is half-way through the joint.
A rigid body is given by four points: its centre and the tips of its three principal axes.
Components come first and a batch of arms last, as in `geometry.lanes`.
"""

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.geometry import lanes
from qjrl.robot.quaternion_arm.description import QuaternionArm
from qjrl.robot.quaternion_arm.joint import height_of_cosine


@struct.dataclass
class SegmentShape:
    """A segment at half angles (2, *batch) [rad]."""

    points: jax.Array
    """(3, points, *batch): per joint chord and link, of each the centre [m] and the three axes."""
    end: jax.Array
    """(3, *batch) [m]."""
    rotation: jax.Array
    """(3, 3, *batch) of the end."""
    turning: jax.Array
    """(3, 2, *batch) angular velocity of the end for a rate of each half angle."""
    bend: jax.Array
    """(2, *batch) a of its joints."""
    height: jax.Array
    """(*batch) H(theta) [m]."""
    cosine: jax.Array
    """(*batch) cos(theta/2)."""


@struct.dataclass
class SegmentMotion:
    """A shape and its derivatives."""

    at: SegmentShape
    slope: SegmentShape
    """By each half angle, along a new first axis."""
    rate: SegmentShape
    """By time."""
    drift: SegmentShape
    """By time twice, at constant rates of the half angles."""


def segment_shape(arm: QuaternionArm, count: int, half_angles: jax.Array) -> SegmentShape:
    """A segment of `count` joints at half angles (2, *batch) [rad]."""
    (sine_x, sine_y), (cosine_x, cosine_y) = jnp.sin(half_angles), jnp.cos(half_angles)
    bend, cosine = jnp.stack([sine_y, -sine_x * cosine_y]), cosine_x * cosine_y
    half = jnp.stack([*bend, cosine])
    height, link_length = height_at(arm, cosine), arm.link_length.astype(half.dtype)
    home_height = height_at(arm, jnp.ones((), half.dtype))
    chord, turn = _chord(sine_x, cosine_x, sine_y, cosine_y), _half_turn(half)
    turning_once = _turning(sine_x, cosine_x, sine_y, cosine_y)
    end, rotation, turning = jnp.zeros_like(half), lanes.identity_like(chord), jnp.zeros_like(turning_once)
    points = []
    for _ in range(count):
        along = lanes.times(rotation, half)
        turning = turning + lanes.product(rotation, turning_once)
        points += [end + 0.5 * home_height * along, *_columns(lanes.product(rotation, chord))]
        rotation = lanes.product(rotation, turn)
        plate = end + height * along
        points += [plate + 0.5 * link_length * rotation[:, 2], *_columns(rotation)]
        end = plate + link_length * rotation[:, 2]
    return SegmentShape(jnp.stack(points, axis=1), end, rotation, turning, bend, height, cosine)


def segment_motions(arm: QuaternionArm, half_angles: jax.Array, rates: jax.Array) -> list[SegmentMotion]:
    """Every segment at half angles and rates (segments, 2, *batch); those of equally many joints side by side."""
    found: dict[int, SegmentMotion] = {}
    for count in sorted(set(arm.joints_per_segment)):
        rows = [row for row, other in enumerate(arm.joints_per_segment) if other == count]
        together = [jnp.stack([values[row] for row in rows], axis=-1) for values in (half_angles, rates)]
        motion = _motion(arm, count, *together)
        for place, row in enumerate(rows):
            found[row] = jax.tree.map(lambda value, place=place: value[..., place], motion)
    return [found[row] for row in range(arm.num_segments)]


def height_at(arm: QuaternionArm, cosine: jax.Array) -> jax.Array:
    """H(theta) [m] at cos(theta/2)."""
    crossed, pins, offset = (
        length.astype(cosine.dtype) for length in (arm.crossed_link_length, arm.pin_distance, arm.plate_to_pin)
    )
    return height_of_cosine(crossed, pins, offset, cosine)


def _motion(arm: QuaternionArm, count: int, angles: jax.Array, rates: jax.Array) -> SegmentMotion:
    shape = lambda angles: segment_shape(arm, count, angles)  # noqa: E731
    (at, rate), (_, drift) = jax.jvp(lambda angles: jax.jvp(shape, (angles,), (rates,)), (angles,), (rates,))
    units = [jnp.zeros_like(angles).at[index].set(1.0) for index in range(2)]
    x, y = (jax.jvp(shape, (angles,), (unit,))[1] for unit in units)
    return SegmentMotion(at, jax.tree.map(lambda *both: jnp.stack(both), x, y), rate, drift)


def _chord(sine_x, cosine_x, sine_y, cosine_y):
    """Rx(x) Ry(y)."""
    zero = jnp.zeros_like(sine_x)
    return lanes.from_rows(
        [cosine_y, zero, sine_y],
        [sine_x * sine_y, cosine_x, -sine_x * cosine_y],
        [-cosine_x * sine_y, sine_x, cosine_x * cosine_y],
    )


def _half_turn(n):
    """Rot(n, pi) Rot(z, pi) (Eq. 2 of paper 000)."""
    x, y, z = n
    return lanes.from_rows(
        [1.0 - 2.0 * x * x, -2.0 * x * y, 2.0 * x * z],
        [-2.0 * x * y, 1.0 - 2.0 * y * y, 2.0 * y * z],
        [-2.0 * x * z, -2.0 * y * z, 2.0 * z * z - 1.0],
    )


def _turning(sine_x, cosine_x, sine_y, cosine_y):
    """Angular velocity of a joint's upper plate: lower hinges x, y, then upper y, x, whose axes lie where those before
    have turned them, e_x + Rx(x) Ry(2y) e_x and 2 Rx(x) e_y."""
    sine, cosine = 2.0 * sine_y * cosine_y, cosine_y**2 - sine_y**2
    zero = jnp.zeros_like(sine)
    return lanes.from_rows([1.0 + cosine, zero], [sine_x * sine, 2.0 * cosine_x], [-cosine_x * sine, 2.0 * sine_x])


def _columns(matrix) -> list:
    return [matrix[:, 0], matrix[:, 1], matrix[:, 2]]
