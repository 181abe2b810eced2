"""How a pose differs from the nominal one, as six numbers that a model can learn, and the pose of such numbers.

"split": shift of the position and rotation vector of R_a R_n^T, both in the base frame;
"body_twist": log(T_n^-1 T_a), seen from the nominal tip; "spatial_twist": log(T_a T_n^-1), whose translation part mixes the turn with
the lever arm from the base.
"""

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qjrl.geometry import se3
from qjrl.geometry.pose import pose_from_frame, position_of, rotation_of

PoseCoding = Literal["split", "body_twist", "spatial_twist"]


def encode(coding: str, nominal: Float[Array, "9"], actual: Float[Array, "9"]) -> Float[Array, "6"]:
    """What takes the nominal pose to the actual one: [m], then [rad]."""
    if coding == "split":
        turn = se3.log_rotation(rotation_of(actual) @ rotation_of(nominal).T)
        return jnp.concatenate([position_of(actual) - position_of(nominal), turn])
    nominal_frame, actual_frame = se3.frame_of(nominal), se3.frame_of(actual)
    if coding == "body_twist":
        return se3.log(se3.inverse(nominal_frame) @ actual_frame)
    return se3.log(actual_frame @ se3.inverse(nominal_frame))


def decode(coding: str, nominal: Float[Array, "9"], numbers: Float[Array, "6"]) -> jax.Array:
    """Pose (9,) that lies so far from the nominal one: `encode` undone."""
    if coding == "split":
        rotation = se3.exp_rotation(numbers[3:]) @ rotation_of(nominal)
        return pose_from_frame(position_of(nominal) + numbers[:3], rotation)
    nominal_frame, motion = se3.frame_of(nominal), se3.exp(numbers)
    return se3.pose_of(nominal_frame @ motion if coding == "body_twist" else motion @ nominal_frame)
