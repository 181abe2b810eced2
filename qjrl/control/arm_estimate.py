"""Where this arm rests, by its encoders and by what arms of its make do: the best linear estimate from a mean of readings.

Before anything is read, an arm is believed to rest where its description says, give or take the servos' gain, the lean
of the base and what friction the dither leaves. These move eight numbers of the readings in few directions, so that a
short mean says more about the tip than the encoders' noise alone would let it: all else in the mean is noise.
"""

import math
from functools import partial
from typing import Annotated, Any

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.config import Range, configuration
from qjrl.control.sensors import encoders_of, exact_reading
from qjrl.geometry import cholesky
from qjrl.robot.kinds import configuration_shape, kind_of, num_coordinates
from qjrl.robot.verbs import Robot, configuration_from_cables, equilibrium

# Variance of what nothing is believed of, in those of one reading.
_VAGUE = 1e6


@configuration
class EstimateConfig:
    """Standard deviations of what is not known of an arm; ours."""

    gain: Annotated[float, Range(above=0.0)] = 0.13
    """Of the logarithm of the servos' gain; 0.13 is that of gains between 0.8 and 1.25."""
    tilt_deg: Annotated[float, Range(above=0.0)] = 2.5
    """Of the base's lean about x and about y [deg]; 2.5 is that of leans up to 5 in any direction."""
    friction: Annotated[float, Range(above=0.0)] = 0.1
    """Of the friction that dither leaves in a strand [N]."""
    encoder_noise_deg: Annotated[float, Range(above=0.0)] = 0.25
    """Of one reading of a joint's encoders [deg]."""
    acts: bool = True
    """Whether the controller makes up for what the tip lacks by the estimate, a policy's action being added to that."""


@struct.dataclass
class Prior:
    """What is believed of an arm before it is read."""

    expected: Any
    """(...) how far from where a perfect arm would be it rests, as in `sensors.remember` [rad]."""
    covariance: Any
    """(coordinates, coordinates) of that, in standard deviations of one reading."""


def prior(config: EstimateConfig, robot: Robot, base_lengths: jax.Array) -> Prior:
    """Of an arm that shall hold cable lengths (num_cables,) [m]; where no pose is stable, or its kind has no statics, next
    to nothing."""
    size, dtype = num_coordinates(robot), base_lengths.dtype
    if kind_of(robot).equilibrium is None:
        return Prior(jnp.zeros(configuration_shape(robot), dtype), _VAGUE * jnp.eye(size, dtype=dtype))
    rest = equilibrium(robot, base_lengths)
    unknown = (
        config.gain * rest.by_gain[..., None],
        math.radians(config.tilt_deg) * rest.by_tilt,
        config.friction * rest.by_pull,
    )
    turned = jax.jacfwd(partial(exact_reading, robot))(rest.configuration).reshape(size, size)
    causes = turned @ jnp.concatenate(unknown, axis=-1).reshape(size, -1)
    causes = causes / _noise(config, robot).reshape(-1, 1).astype(causes.dtype)
    held = configuration_from_cables(robot, base_lengths)
    expected = exact_reading(robot, rest.configuration) - exact_reading(robot, held)
    covariance = causes @ causes.T
    is_stable = jnp.all(jnp.isfinite(expected)) & jnp.all(jnp.isfinite(covariance))
    vague = _VAGUE * jnp.eye(len(covariance))
    return Prior(
        jnp.where(is_stable, expected, 0.0).astype(dtype), jnp.where(is_stable, covariance, vague).astype(dtype)
    )


@partial(jax.jit, static_argnums=0)
def priors(config: EstimateConfig, robot: Robot, base_lengths: jax.Array) -> Prior:
    """Of as many arms as there are rows of `base_lengths` (n, num_cables) [m]."""
    return jax.vmap(lambda lengths: prior(config, robot, lengths))(base_lengths)


def estimate(config: EstimateConfig, robot: Robot, believed: Prior, mean: jax.Array, count: jax.Array) -> jax.Array:
    """[rad] from the mean of `count` readings: the linear minimum mean-square-error update."""
    noise = _noise(config, robot).astype(mean.dtype)
    innovation = ((mean - believed.expected) / noise).reshape(-1)
    total = believed.covariance + jnp.eye(len(innovation), dtype=mean.dtype) / count
    found = believed.covariance @ cholesky.solve(cholesky.factor(total), innovation)
    return believed.expected + noise * found.reshape(mean.shape)


def _noise(config: EstimateConfig, robot: Robot) -> jax.Array:
    """Of a reading, of the configuration's shape [rad]; each row is the mean over its joints."""
    counts, shape = jnp.array(encoders_of(robot), float)[:, None], configuration_shape(robot)
    each = math.radians(config.encoder_noise_deg) / jnp.sqrt(counts)
    return jnp.broadcast_to(each, (len(counts), math.prod(shape) // len(counts))).reshape(shape)
