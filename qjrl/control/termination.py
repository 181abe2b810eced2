"""When an arm is lost, and its episode ends for good: motors that cannot hold it, or joints forced past their stops.

Other than a time limit, which cuts an episode off, this is an end after which nothing comes.
"""

import math
from typing import Annotated

import jax
import jax.numpy as jnp

from qjrl.config import Range, configuration
from qjrl.robot import configuration_from_joint_positions
from qjrl.robot.kinds import kind_of, verb
from qjrl.robot.plant import PlantState
from qjrl.robot.verbs import Robot, is_at_strength


@configuration
class TerminationConfig:
    """All ours; an arm that follows commands within its limits comes near none of it."""

    overload_time: Annotated[float, Range(low=0.0)] = 0.2
    """A motor at its force, or a strand at its strength, for longer than this loses the arm [s]."""
    excess_deg: Annotated[float, Range(above=0.0)] = 3.0
    """So does a joint that is bent further than this beyond its stop [deg]."""
    cost: Annotated[float, Range(low=0.0)] = 40.0
    """Taken off the reward of the step that loses the arm: more than an episode can cost otherwise, so that no policy seeks the end."""


def is_overloaded(robot: Robot, plant: PlantState) -> jax.Array:
    """Whether a motor pulls with all its force or a strand with all its strength, of tensions (strands,) [N]."""
    force = verb(robot, "motor_force")(robot, plant.strand_tension)
    stalls = jnp.any(jnp.abs(force) >= robot.motor_force)
    return stalls | jnp.any(is_at_strength(robot, plant.strand_tension))


def overloaded_for(robot: Robot, before: jax.Array, plant: PlantState, period: float) -> jax.Array:
    """Time [s] for which the arm has been overloaded without a break, one control period after it was `before`."""
    return jnp.where(is_overloaded(robot, plant), before + period, 0.0)


def is_lost(config: TerminationConfig, robot: Robot, plant: PlantState, overloaded: jax.Array) -> jax.Array:
    """Whether the arm is lost, `overloaded` being what `overloaded_for` says [s]."""
    has_stalled, excess = overloaded > config.overload_time, kind_of(robot).excess
    if excess is None:
        return has_stalled
    configuration = configuration_from_joint_positions(robot, plant.joint_positions)
    return has_stalled | (excess(robot, configuration) > math.radians(config.excess_deg))
