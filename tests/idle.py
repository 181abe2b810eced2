"""A policy that does nothing, for a robot and an environment."""

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.control.controller import observation, prepare
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.motors import action_size
from qjrl.learning.ppo.policy import Policy
from qjrl.robot.verbs import Robot


def idle_policy(robot: Robot, config: EnvironmentConfig) -> Policy:
    control, outputs = config.controller, 2 * action_size(config.residual, robot)
    task = jnp.zeros(9), jnp.zeros(robot.num_cables), jnp.zeros((robot.num_segments, 2))
    seen = jax.eval_shape(lambda *task: observation(control, robot, prepare(control, robot, *task)), *task)
    size = seen.shape[0]
    layer = {"kernel": np.zeros((size, outputs), np.float32), "bias": np.zeros(outputs, np.float32)}
    return Policy({"hidden_0": layer}, np.zeros(size, np.float32), np.ones(size, np.float32), "swish", 10.0)
