"""What the real robot senses: joint encoders with noise, and a memory of them.

Each joint's encoders measure its bend as a rotation vector theta (cos phi, sin phi) with white noise. The joints of a
segment bend alike, so their mean is the segment's estimate (our reading of the paper's "estimated bend angle and
direction for each segment, derived via polynomial fitting"). The memory holds means of the readings' deviation from
where the command would hold a perfect arm: it changes slowly while the command moves, so that it can be averaged for
seconds, as the noise demands. Three means are exponential, one is plain; when the arm has arrived all begin anew. What is
read on the way lags behind the command by any delay of the motors, and a policy that had learnt to make use of it, without
delays, was 5.8 times worse than its base with one of 40 ms.
"""

import math

import jax
import jax.numpy as jnp

from qjrl.geometry.rotations import safe_norm
from qjrl.robot.quaternion_arm.description import QuaternionArm
from qjrl.robot.quaternion_arm.joint import bend_angle

# Time constants of the memory [s]; at 50 Hz they average about 10, 40 and 160 frames.
TIME_CONSTANTS = (0.1, 0.4, 1.6)
# The means of what is read at the end begin this long after the arm has arrived [s].
SETTLING = 0.1
MEMORY_SIZE = len(TIME_CONSTANTS) + 1


def rotation_vectors(bends: jax.Array) -> jax.Array:
    """theta (cos phi, sin phi) [rad] of bends (segments, 2); smooth at 0."""
    angles = jax.vmap(bend_angle)(bends)
    sines = jax.vmap(safe_norm)(bends)
    ratio = jnp.where(sines > 1e-9, angles / jnp.maximum(sines, 1e-9), 2.0)
    return bends * ratio[:, None]


def bends_of_rotation_vectors(vectors: jax.Array) -> jax.Array:
    """Inverse of `rotation_vectors`."""
    half = jax.vmap(safe_norm)(vectors) / 2.0
    return vectors * (jnp.sinc(half / jnp.pi) / 2.0)[:, None]


def read_encoders(
    arm: QuaternionArm, bends: jax.Array, noise_deg: float, key: jax.Array, working: jax.Array
) -> jax.Array:
    """Segment estimates (segments, 2) [rad] from true bends: means over a segment's joints, each with noise of `noise_deg`.

    Of n joints those beyond the first `working` (segments,) have dead encoders, which read no bend and have no noise.
    """
    count = jnp.array(arm.joints_per_segment, jnp.float32)
    share = working / count
    deviation = math.radians(noise_deg) / jnp.sqrt(count) * jnp.sqrt(share)
    return share[:, None] * rotation_vectors(bends) + deviation[:, None] * jax.random.normal(key, bends.shape)


def remember(memory: jax.Array, deviation: jax.Array, waited: jax.Array, period: float) -> jax.Array:
    """The memory (MEMORY_SIZE, segments, 2) one control period [s] later: exponential means, plain mean of the end.

    A reading weighs as much as any of an exponential mean's before it until that has as many as its time constant holds.

    Args:
        waited: time [s] since the base command is ramped in, 0 on the way; the means of the end begin `SETTLING` later.
    """
    exponential, plain = 1.0 - jnp.exp(-period / jnp.array(TIME_CONSTANTS)), 1.0 / readings_at_the_end(waited, period)
    begun = jnp.where(waited > 0.0, jnp.maximum(exponential, plain), exponential)
    return memory + jnp.append(begun, plain)[:, None, None] * (deviation - memory)


def readings_at_the_end(waited: jax.Array, period: float) -> jax.Array:
    """How many readings the plain mean holds, a time [s] after the base command is ramped in; at least 1."""
    return jnp.maximum(waited - SETTLING, 0.0) / period + 1.0
