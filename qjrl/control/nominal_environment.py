"""The residual environment of a robot without any learned model: targets drawn, answered by the closed form."""

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import ConfigError
from qjrl.control.environment import ResidualEnv, residual_env
from qjrl.control.episode import Bank, EnvironmentConfig
from qjrl.control.evaluation import arrives_in_time
from qjrl.control.targets import draw_configurations, target_poses
from qjrl.robot import cable_lengths, load_robot
from qjrl.robot.verbs import Robot
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.engines import make_engine


def nominal_environment(
    robot: str,
    config: EnvironmentConfig = EnvironmentConfig(),
    engine: EngineConfig = EngineConfig(),
    num_targets: int = 1024,
    seed: int = 0,
) -> ResidualEnv:
    """The environment of a shipped name or a YAML file.

    Args:
        num_targets: drawn, bends uniform up to the limit; those that the motors do not reach in time are left out.
        seed: of the targets.
    Raises:
        ConfigError: no such robot, or no target is reached in time.
    """
    with jax.enable_x64(True):
        arm = load_robot(robot)
        bank = nominal_bank(arm, config, num_targets, seed)
        return residual_env(arm, config, bank, make_engine(arm, engine))


def nominal_bank(robot: Robot, config: EnvironmentConfig, num_targets: int, seed: int) -> Bank:
    """Targets with uniform bends that the arm reaches in time, and the closed form's commands for them."""
    bends = draw_configurations(robot, "uniform", num_targets, seed)
    lengths = jax.vmap(lambda row: cable_lengths(robot, row))(jnp.asarray(bends))
    in_time = np.flatnonzero(arrives_in_time(robot, config, np.asarray(lengths)))
    if len(in_time) == 0:
        raise ConfigError(
            f"latest_arrival: got {config.latest_arrival:g} s, allowed: more; the motors reach none of {num_targets} targets"
        )
    return Bank(jnp.asarray(target_poses(robot, bends)[in_time]), lengths[in_time])
