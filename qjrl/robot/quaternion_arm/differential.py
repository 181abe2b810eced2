"""Tip pose and its Jacobian in closed form, in bend vectors theta_k (cos phi_k, sin phi_k) [rad].

A segment of m equal joints bends in one plane, so its end is a point (X, Z) of that plane and a turn by m theta. All
of it is written in q = theta^2, S = sin(theta/2) / theta and c = cos(theta/2) with Chebyshev polynomials
U_n(c) = sin((n+1) theta/2) / sin(theta/2): nothing divides by theta, and no angle but theta/2 needs a sine.

Components come first and a batch of arms last, (3, n) and not (n, 3): every line is then one long vector operation,
several times quicker on a CPU than a `vmap` of small matrices. Without trailing axes the functions take one arm.
"""

import itertools

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from qjrl.geometry import batch_last
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.joint import height_of_cosine
from qjrl.robot.tip import Tip


@struct.dataclass
class SegmentEnd:
    """End of a segment in the frame of its base, and how it moves with the segment's bend vector."""

    position: Float[Array, "3 *batch"]
    rotation: Float[Array, "3 3 *batch"]
    velocity: Float[Array, "3 2 *batch"]
    angular_velocity: Float[Array, "3 2 *batch"]


def tip_of(arm: QuaternionArm, vectors: Float[Array, "segments 2 *batch"]) -> Tip:
    """Pose and Jacobian of the tip.

    Args:
        vectors: bend vectors theta_k (cos phi_k, sin phi_k) [rad].
    """
    batch = vectors.shape[2:]
    position = jnp.zeros((3, *batch), vectors.dtype)
    rotation = jnp.broadcast_to(jnp.eye(3, dtype=vectors.dtype).reshape(3, 3, *[1] * len(batch)), (3, 3, *batch))
    ends, velocities, turnings = [], [], []
    for count, vector in zip(arm.joints_per_segment, vectors, strict=True):
        segment = segment_end(arm, count, vector)
        velocities.append(batch_last.product(rotation, segment.velocity))
        turnings.append(batch_last.product(rotation, segment.angular_velocity))
        position = position + batch_last.times(rotation, segment.position)
        rotation = batch_last.product(rotation, segment.rotation)
        ends.append(position)
    swung = [
        velocity + batch_last.cross(turning, (position - end)[:, None])
        for velocity, turning, end in zip(velocities, turnings, ends, strict=True)
    ]
    return Tip(position, rotation, jnp.concatenate(swung, axis=1), jnp.concatenate(turnings, axis=1))


def segment_end(arm: QuaternionArm, count: int, vector: Float[Array, "2 *batch"]) -> SegmentEnd:
    """End of a segment of `count` joints (Eqs. 2-3 of paper 000, composed and differentiated).

    With the plane's unit vectors u = vector/theta and e_z: position X u + Z e_z, rotation by m theta about e_z x u.
    """
    x, y = vector
    squared = jnp.maximum(x**2 + y**2, _TINY)  # moves nothing by more than rounding, and nothing divides by zero
    angle = jnp.sqrt(squared)
    cosine, sine_ratio = jnp.cos(angle / 2.0), jnp.sin(angle / 2.0) / angle  # c, S
    cosine_rate, sine_rate = -sine_ratio / 4.0, (cosine / 2.0 - sine_ratio) / (2.0 * squared)  # d/dq
    (across, along), (across_rate, along_rate) = jax.jvp(
        lambda c: _plane_curve(arm, count, c), (cosine,), (cosine_rate,)
    )
    across, across_rate = sine_ratio * across, sine_ratio * across_rate + sine_rate * across  # X/theta, its d/dq
    chebyshev = _chebyshev(cosine, 2 * count)
    swing = sine_ratio * chebyshev[2 * count - 1]  # sin(m theta) / theta
    lean = 2.0 * (sine_ratio * chebyshev[count - 1]) ** 2  # (1 - cos(m theta)) / theta^2
    twist = (count - swing) / squared
    one = jnp.ones_like(x)
    return SegmentEnd(
        jnp.stack([across * x, across * y, along]),
        batch_last.from_rows(
            [one - lean * x * x, -lean * x * y, swing * x],
            [-lean * x * y, one - lean * y * y, swing * y],
            [-swing * x, -swing * y, one - lean * squared],
        ),
        batch_last.from_rows(
            [across + 2.0 * across_rate * x * x, 2.0 * across_rate * x * y],
            [2.0 * across_rate * x * y, across + 2.0 * across_rate * y * y],
            [2.0 * along_rate * x, 2.0 * along_rate * y],
        ),
        batch_last.from_rows(
            [-twist * x * y, twist * x * x - count], [count - twist * y * y, twist * x * y], [-lean * y, lean * x]
        ),
    )


def _plane_curve(arm: QuaternionArm, count: int, cosine):
    """(X / sin(theta/2), Z) of a segment's end: joint i leans (2i - 1) theta/2 and carries H, link i leans i theta."""
    crossed, pins, offset = (
        jnp.asarray(length, cosine.dtype) for length in (arm.crossed_link_length, arm.pin_distance, arm.plate_to_pin)
    )
    height = height_of_cosine(crossed, pins, offset, cosine)
    link = jnp.asarray(arm.link_length, cosine.dtype)
    sines = _chebyshev(cosine, 2 * count)  # sin(n theta/2) / sin(theta/2) at n - 1
    cosines = [sines[0], *(after - cosine * before for before, after in itertools.pairwise(sines))]
    across = sum(height * sines[2 * i] + link * sines[2 * i + 1] for i in range(count))
    along = sum(height * cosines[2 * i + 1] + link * cosines[2 * i + 2] for i in range(count))
    return across, along


def _chebyshev(cosine, degree: int) -> list:
    """U_0 ... U_degree at c, second kind: U_n = 2 c U_(n-1) - U_(n-2)."""
    values = [jnp.ones_like(cosine), 2.0 * cosine]
    for _ in range(degree - 1):
        values.append(2.0 * cosine * values[-1] - values[-2])
    return values


# theta^2 of a straight joint: 1e-6 rad, whose square is far below rounding against 1.
_TINY = 1e-12
