"""What the real robot senses: joint encoders with noise, and a memory of them.

Encoders measure the coordinates of a configuration with white noise: of the quaternion-joint arm each joint's bend as
a rotation vector theta (cos phi, sin phi). The joints of a segment bend alike, so their mean is the segment's
estimate (our reading of the paper's "estimated bend angle and direction for each segment, derived via polynomial
fitting"). The memory holds means of the readings' deviation from where the command would hold a perfect arm: it
changes slowly while the command moves, so that it can be averaged for seconds, as the noise demands. Three means are
exponential, one is plain; when the arm has arrived all begin anew. What is read on the way lags behind the command by
any delay of the motors, and a policy that had learnt to make use of it, without delays, was 5.8 times worse than its
base with one of 40 ms.
"""

import math

import jax
import jax.numpy as jnp

from qjrl.robot.kinds import kind_of, num_coordinates
from qjrl.robot.verbs import Robot

# Time constants of the memory [s]; at 50 Hz they average about 10, 40 and 160 frames.
TIME_CONSTANTS = (0.1, 0.4, 1.6)
# The means of what is read at the end begin this long after the arm has arrived [s].
SETTLING = 0.1
MEMORY_SIZE = len(TIME_CONSTANTS) + 1


def exact_reading(robot: Robot, configuration: jax.Array) -> jax.Array:
    """What encoders without noise read of a configuration: its coordinates, in the shape of the configuration."""
    return kind_of(robot).coordinates_of(robot, configuration).reshape(configuration.shape)


def sensed_configuration(robot: Robot, reading: jax.Array) -> jax.Array:
    """Inverse of `exact_reading`."""
    return kind_of(robot).configuration_of(robot, reading.reshape(-1))


def encoders_of(robot: Robot) -> tuple[int, ...]:
    """How many joint encoders each row of a reading is the mean of."""
    encoders = kind_of(robot).encoders
    return encoders(robot) if encoders is not None else (1,) * num_coordinates(robot)


def read_encoders(
    robot: Robot, configuration: jax.Array, noise_deg: float, key: jax.Array, working: jax.Array
) -> jax.Array:
    """A reading of a configuration: each row the mean over its joints, each with noise of `noise_deg`.

    Of n joints those beyond the first `working` (rows,) have dead encoders, which read zero and have no noise.
    """
    count = jnp.array(encoders_of(robot), jnp.float32)
    share = working / count
    deviation = math.radians(noise_deg) / jnp.sqrt(count) * jnp.sqrt(share)
    exact = exact_reading(robot, configuration).reshape(len(count), -1)
    noise = jax.random.normal(key, configuration.shape).reshape(exact.shape)
    return (share[:, None] * exact + deviation[:, None] * noise).reshape(configuration.shape)


def remember(memory: jax.Array, deviation: jax.Array, waited: jax.Array, period: float) -> jax.Array:
    """The memory, `MEMORY_SIZE` readings, one control period [s] later: exponential means, plain mean of the end.

    A reading weighs as much as any of an exponential mean's before it until that has as many as its time constant holds.

    Args:
        waited: time [s] since the base command is ramped in, 0 on the way; the means of the end begin `SETTLING` later.
    """
    exponential, plain = 1.0 - jnp.exp(-period / jnp.array(TIME_CONSTANTS)), 1.0 / readings_at_the_end(waited, period)
    begun = jnp.where(waited > 0.0, jnp.maximum(exponential, plain), exponential)
    return memory + jnp.append(begun, plain).reshape(-1, *[1] * deviation.ndim) * (deviation - memory)


def readings_at_the_end(waited: jax.Array, period: float) -> jax.Array:
    """How many readings the plain mean holds, a time [s] after the base command is ramped in; at least 1."""
    return jnp.maximum(waited - SETTLING, 0.0) / period + 1.0
