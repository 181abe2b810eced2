"""The two sets of targets that controllers are trained and evaluated on."""

from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import Range, configuration
from qjrl.robot import forward_kinematics
from qjrl.robot.kinds import verb
from qjrl.robot.verbs import Robot

# name -> law. Both sets are always evaluated; the first is the headline.
TARGET_SETS = ("uniform", "near_home")


@configuration
class TargetConfig:
    """Laws of the targets."""

    largest_distance: Annotated[float, Range(above=0.0, high=10.0)] = 0.3
    """d_max of d = d_max u^3 [m], distance of the target tip from the home tip (paper 000, section 5.4.2)."""


def draw_configurations(
    robot: Robot, target_set: str, count: int, seed: int, config: TargetConfig = TargetConfig()
) -> np.ndarray:
    """Bends (count, segments, 2) of a target set; row i depends on (set, seed, i) alone.

    Args:
        target_set: "uniform": theta uniform up to the limit; "near_home": the paper's law, half of it within 37 mm.
    Raises:
        ValueError: unknown set.
    """
    if target_set not in TARGET_SETS:
        raise ValueError(f"target_set: got {target_set!r}, allowed: {', '.join(TARGET_SETS)}")
    base = jax.random.fold_in(jax.random.key(seed), TARGET_SETS.index(target_set))
    keys = jax.vmap(lambda row: jax.random.fold_in(base, row))(jnp.arange(count))
    draw = {"uniform": _uniform, "near_home": _near_home}[target_set]
    return np.asarray(jax.jit(jax.vmap(lambda key: draw(robot, key, config)))(keys))


def target_poses(robot: Robot, bends: np.ndarray) -> np.ndarray:
    """Poses (n, 9) that the nominal kinematics gives for configurations (n, ...)."""
    return np.asarray(jax.jit(jax.vmap(lambda row: forward_kinematics(robot, row)))(jnp.asarray(bends)))


def _uniform(robot: Robot, key: jax.Array, config: TargetConfig) -> jax.Array:
    del config
    return verb(robot, "random")(robot, key)


def _near_home(robot: Robot, key: jax.Array, config: TargetConfig) -> jax.Array:
    key_distance, key_direction = jax.random.split(key)
    distance = config.largest_distance * jax.random.uniform(key_distance) ** 3
    return verb(robot, "at_distance")(robot, key_direction, distance)
