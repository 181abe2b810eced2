"""How near the encoders alone could tell where the tip is: the floor under every controller that trusts only them."""

import jax
import jax.numpy as jnp

from qjrl.control.sensors import read_encoders, rotation_vectors
from qjrl.control.tip_correction import sensed_pose
from qjrl.geometry.pose import position_error
from qjrl.robot.verbs import Robot


def encoder_floor(robot: Robot, bends: jax.Array, noise_deg: float, frames: jax.Array, key: jax.Array) -> jax.Array:
    """Error (n,) [m] of the tip by the mean of so many readings of an arm that rests.

    No controller without other knowledge can rest nearer to its target than it knows where it is; one that knows what
    the arms are like (their gains, their tilts) can.

    Args:
        bends: (n, segments, 2), where the arms rest.
        noise_deg: standard deviation of one joint's encoder [deg].
        frames: (n,) readings averaged, at least 1.
    """

    working = jnp.array(robot.joints_per_segment)

    def one(bends, frames, key):
        exact = rotation_vectors(bends)
        mean = exact + (read_encoders(robot, bends, noise_deg, key, working) - exact) / jnp.sqrt(frames)
        return position_error(sensed_pose(robot, mean), sensed_pose(robot, exact))

    return jax.vmap(one)(bends, frames, jax.random.split(key, len(bends)))
