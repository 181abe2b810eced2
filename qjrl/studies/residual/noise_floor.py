"""How near the encoders alone could tell where the tip is: the floor under every controller that trusts only them."""

import jax
import jax.numpy as jnp

from qjrl.control.sensors import encoders_of, exact_reading, read_encoders
from qjrl.control.tip_correction import sensed_pose
from qjrl.geometry.pose import position_error
from qjrl.robot.verbs import Robot


def encoder_floor(
    robot: Robot, configurations: jax.Array, noise_deg: float, frames: jax.Array, key: jax.Array
) -> jax.Array:
    """Error (n,) [m] of the tip by the mean of so many readings of an arm that rests.

    No controller without other knowledge can rest nearer to its target than it knows where it is; one that knows what
    the arms are like (their gains, their tilts) can.

    Args:
        configurations: (n, ...), where the arms rest.
        noise_deg: standard deviation of one joint's encoder [deg].
        frames: (n,) readings averaged, at least 1.
    """

    working = jnp.array(encoders_of(robot))

    def one(configuration, frames, key):
        exact = exact_reading(robot, configuration)
        mean = exact + (read_encoders(robot, configuration, noise_deg, key, working) - exact) / jnp.sqrt(frames)
        return position_error(sensed_pose(robot, mean), sensed_pose(robot, exact))

    return jax.vmap(one)(configurations, frames, jax.random.split(key, len(configurations)))
