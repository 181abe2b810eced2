"""What stands between the controller and the arm at hand: a delay and backlash on the way out, dead encoders on the way in.

Drawn once an episode. The controller knows nothing of it.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.control.randomisation import RandomisationConfig
from qjrl.control.sensors import encoders_of
from qjrl.robot.verbs import Robot


@struct.dataclass
class Faults:
    """Those of one arm, and what is under way."""

    delay: jax.Array
    """Control periods that a command takes to the motors."""
    backlash: jax.Array
    """Half the width of the dead band between motors and cables [m]."""
    working_encoders: jax.Array
    """(rows,) encoders of each row of a reading that work; the others read zero."""
    sent: jax.Array
    """(largest delay, num_cables) commands [m] under way, newest first."""
    held: jax.Array
    """(num_cables,) what the cables hold [m]."""


def draw_faults(config: RandomisationConfig, robot: Robot, key: jax.Array, held: jax.Array) -> Faults:
    """Faults of a new episode, at whose start the cables hold `held` (num_cables,) [m] and nothing else is under way."""
    key_delay, key_backlash, key_dead, key_joint = jax.random.split(key, 4)
    shortest, longest = config.delay
    low, high = config.backlash
    counts = encoders_of(robot)
    row = jnp.asarray(np.repeat(np.arange(len(counts)), counts))[jax.random.randint(key_joint, (), 0, sum(counts))]
    is_dead = jax.random.uniform(key_dead) < config.dead_encoder_share
    dead = is_dead & (jnp.arange(len(counts)) == row)
    return Faults(
        delay=jax.random.randint(key_delay, (), shortest, longest + 1),
        backlash=low + (high - low) * jax.random.uniform(key_backlash),
        working_encoders=jnp.array(counts, held.dtype) - dead,
        sent=jnp.broadcast_to(held, (longest, *held.shape)),
        held=held,
    )


def transmit(faults: Faults, command: jax.Array) -> Faults:
    """One control period later, in which the controller commands cable lengths (num_cables,) [m]."""
    queue = jnp.concatenate([command[None], faults.sent])
    held = play(faults.held, queue[faults.delay], faults.backlash).astype(command.dtype)
    return dataclasses.replace(faults, sent=queue[:-1], held=held)


def play(held: jax.Array, driver: jax.Array, half_width: jax.Array) -> jax.Array:
    """The play operator: what a driver at `driver` drags along with a dead band of `half_width` to either side [m]."""
    return jnp.clip(held, driver - half_width, driver + half_width)
