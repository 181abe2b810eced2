"""Rigid motions: 4 x 4 frames, their exponential and logarithm. A twist is (v [m], w [rad]), translation part first.

Near no turn, where quotients of sines lose their digits, power series stand for them; the logarithm of a rotation goes through its
quaternion, which keeps all digits up to half a turn. At half a turn itself both axes are right; one of them is answered.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qjrl.geometry.pose import pose_from_frame, position_of, rotation_of


def frame_of(pose: Float[Array, "9"]) -> Float[Array, "4 4"]:
    """Frame of a pose."""
    return make_frame(position_of(pose), rotation_of(pose))


def pose_of(frame: Float[Array, "4 4"]) -> Float[Array, "9"]:
    """Pose of a frame."""
    return pose_from_frame(frame[:3, 3], frame[:3, :3])


def make_frame(position: Float[Array, "3"], rotation: Float[Array, "3 3"]) -> Float[Array, "4 4"]:
    """Frame of a position [m] and a rotation matrix."""
    upper = jnp.concatenate([rotation, position[:, None]], axis=1)
    return jnp.concatenate([upper, jnp.array([[0.0, 0.0, 0.0, 1.0]], upper.dtype)])


def inverse(frame: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """The inverse of a frame."""
    rotation = frame[:3, :3]
    return make_frame(-rotation.T @ frame[:3, 3], rotation.T)


def exp(twist: Float[Array, "6"]) -> Float[Array, "4 4"]:
    """Frame that a twist reaches in unit time."""
    velocity, turn = twist[:3], twist[3:]
    squared = jnp.sum(turn**2)
    once = jnp.cross(turn, velocity)
    position = velocity + _versine(squared) * once + _excess(squared) * jnp.cross(turn, once)
    return make_frame(position, exp_rotation(turn))


def log(frame: Float[Array, "4 4"]) -> Float[Array, "6"]:
    """Twist of a frame, of the shorter turn."""
    turn, position = log_rotation(frame[:3, :3]), frame[:3, 3]
    once = jnp.cross(turn, position)
    velocity = position - 0.5 * once + _inverse_excess(jnp.sum(turn**2)) * jnp.cross(turn, once)
    return jnp.concatenate([velocity, turn])


def exp_rotation(vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rotation matrix of axis times angle [rad]."""
    squared = jnp.sum(vector**2)
    skew = jnp.cross(vector, jnp.eye(3, dtype=vector.dtype)).T
    return jnp.eye(3, dtype=vector.dtype) + sine_ratio(squared) * skew + _versine(squared) * (skew @ skew)


def log_rotation(rotation: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Axis times angle [rad] of a rotation matrix, at most half a turn."""
    r = rotation
    squares = jnp.array(  # 4 q q^T of the quaternion q = (w, x, y, z)
        [
            [1 + r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], 1 + r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], 1 - r[0, 0] + r[1, 1] - r[2, 2], r[1, 2] + r[2, 1]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1 - r[0, 0] - r[1, 1] + r[2, 2]],
        ]
    )
    row = squares[jnp.argmax(jnp.diagonal(squares))]  # of the largest of the four, at least 1/2
    quaternion = row * jax.lax.rsqrt(jnp.sum(row**2))
    quaternion = jnp.where(quaternion[0] < 0.0, -quaternion, quaternion)
    cosine, axis = quaternion[0], quaternion[1:]
    squared = jnp.sum(axis**2)  # of the sine of half the angle
    is_small = squared < _SMALL_SINE
    sine = jnp.sqrt(jnp.where(is_small, 1.0, squared))
    half_over_sine = jnp.where(is_small, 1.0 + squared / 6.0, jnp.arctan2(sine, cosine) / sine)
    return 2.0 * half_over_sine * axis


def sine_ratio(x: Float[Array, ""]) -> Float[Array, ""]:
    """sin(a) / a of x = a^2."""
    angle = _root(x)
    return jnp.where(x < _SERIES, _power_series(x, 1), jnp.sin(angle) / angle)


def _versine(x: Float[Array, ""]) -> Float[Array, ""]:
    """(1 - cos(a)) / a^2 of x = a^2."""
    angle = _root(x)
    return jnp.where(x < _SERIES, _power_series(x, 2), 2.0 * (jnp.sin(angle / 2.0) / angle) ** 2)


def _excess(x: Float[Array, ""]) -> Float[Array, ""]:
    """(a - sin(a)) / a^3 of x = a^2."""
    angle = _root(x)
    return jnp.where(x < _SERIES, _power_series(x, 3), (angle - jnp.sin(angle)) / angle**3)


def _inverse_excess(x: Float[Array, ""]) -> Float[Array, ""]:
    """(1 - (a / 2) cot(a / 2)) / a^2 of x = a^2: of the second power in the inverse of what carries v to the position."""
    half = _root(x) / 2.0
    series = jnp.polyval(jnp.array(_INVERSE_EXCESS[::-1], x.dtype), x)
    return jnp.where(x < _SERIES, series, (1.0 - half / jnp.tan(half)) / (4.0 * half**2))


def _power_series(x: Float[Array, ""], first: int) -> Float[Array, ""]:
    """Sum of (-x)^k / (2 k + first)!."""
    terms = [(-1) ** k / math.factorial(2 * k + first) for k in range(8)]
    return jnp.polyval(jnp.array(terms[::-1], x.dtype), x)


def _root(x: Float[Array, ""]) -> Float[Array, ""]:
    """Angle of its square, where it is used; a harmless number where the series is."""
    return jnp.sqrt(jnp.where(x < _SERIES, 1.0, x))


# Squared angle [rad^2] below which the series are used: their remainder there is below the rounding of float64.
_SERIES = 0.25
# Squared sine below which asin(s) / s = 1 + s^2 / 6 to the rounding of float64.
_SMALL_SINE = 1e-8
# Of (1 - (a / 2) cot(a / 2)) / a^2 in powers of a^2.
_INVERSE_EXCESS = (
    1 / 12,
    1 / 720,
    1 / 30240,
    1 / 1209600,
    1 / 47900160,
    691 / 1307674368000,
    1 / 74724249600,
    3617 / 10670622842880000,
)
