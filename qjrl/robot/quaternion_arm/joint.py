"""One quaternion joint: height, transform and its inverse (paper 000, Eqs. 1-2).

A joint bent by theta in direction phi has the bend a = sin(theta/2) (cos phi, sin phi). Its half-way direction
n = (a, sqrt(1 - |a|^2)) carries everything: the rotation is Rot(n, pi) Rot(z, pi) (a rolling without spin) and the
upper plate sits at H(theta) n. Nothing here is singular at theta = 0.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qjrl.geometry.rotations import safe_norm
from qjrl.robot.quaternion_arm.arm import QuaternionArm


def half_direction(bend: Float[Array, "2"]) -> Float[Array, "3"]:
    """Unit vector n half-way between the two plate normals; |a| is held below 1 (theta below 180 degrees)."""
    cosine_squared = jnp.maximum(1.0 - jnp.sum(bend**2), _SMALLEST_COSINE_SQUARED)
    return jnp.append(bend, jnp.sqrt(cosine_squared))


def joint_height(arm: QuaternionArm, bend: Float[Array, "2"]) -> Float[Array, ""]:
    """Distance H(theta) of the two plates' centres [m]; constant for the spherical joint.

    Source: planar antiparallelogram with crossed links l, pins k apart, pins d off the plates:
    H = sqrt(l^2 - k^2 cos^2(theta/2)) + 2 d cos(theta/2).
    """
    cosine = half_direction(bend)[2]
    return height_of_cosine(arm.crossed_link_length, arm.pin_distance, arm.plate_to_pin, cosine)


def height_of_cosine(crossed_link_length, pin_distance, plate_to_pin, cosine):
    """H from cos(theta/2); plain arithmetic, so that it serves numpy and JAX alike [m]."""
    return (crossed_link_length**2 - (pin_distance * cosine) ** 2) ** 0.5 + 2.0 * plate_to_pin * cosine


def joint_transform(arm: QuaternionArm, bend: Float[Array, "2"]) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Position [m] and rotation of the upper plate in the lower plate's frame.

    Source: paper 000, Eq. 2 with its off-diagonal term corrected (-s_2phi s^2_(theta/2), printed twice that).
    """
    n = half_direction(bend)
    rotation = (2.0 * jnp.outer(n, n) - jnp.eye(3, dtype=n.dtype)) * jnp.array([-1.0, -1.0, 1.0], n.dtype)
    return joint_height(arm, bend) * n, rotation


def bends_from_pose(joint_pose: Float[Array, "9"]) -> Float[Array, "2"]:
    """Bend of one joint from the pose of its upper plate.

    The offset leans by theta/2 in direction phi, so a is its direction's first two components.
    Source: paper 000, Eq. 1: phi = atan2(y, x), theta = 2 atan2(sqrt(x^2 + y^2), z).
    """
    offset = joint_pose[:3]
    return offset[:2] / safe_norm(offset)


def bends_from_angles(direction: Float[Array, "*n"], angle: Float[Array, "*n"]) -> Float[Array, "*n 2"]:
    """Bends from bend direction phi and bend angle theta [rad]."""
    return jnp.sin(angle / 2.0)[..., None] * jnp.stack([jnp.cos(direction), jnp.sin(direction)], axis=-1)


def bend_from_vector(vector: Float[Array, "2"]) -> Float[Array, "2"]:
    """Bend of a bend vector theta (cos phi, sin phi) [rad]; the normalised sinc keeps it regular at 0."""
    return 0.5 * jnp.sinc(safe_norm(vector) / (2.0 * jnp.pi)) * vector


def vector_from_bend(bend: Float[Array, "2"]) -> Float[Array, "2"]:
    """Bend vector theta (cos phi, sin phi) [rad] of a bend: the inverse of `bend_from_vector`."""
    sine = safe_norm(bend)
    return bend * jnp.where(sine > 1e-9, bend_angle(bend) / jnp.maximum(sine, 1e-9), 2.0)


def angles_of_bends(bends: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    """Bend angles theta [rad] of many bends, on the host; what is 1 or longer counts as 180 degrees."""
    return np.asarray(2.0 * np.arcsin(np.minimum(np.linalg.norm(bends, axis=-1), 1.0)))


def bend_angle(bend: Float[Array, "2"]) -> Float[Array, ""]:
    """Bend angle theta [rad], in [0, pi]; its gradient at 0 is zero, not NaN."""
    return 2.0 * jnp.arctan2(safe_norm(bend), half_direction(bend)[2])


# cos(theta/2) at theta = 179.9999 degrees: keeps the square root's gradient finite.
_SMALLEST_COSINE_SQUARED = 1e-12
