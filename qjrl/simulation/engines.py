"""Engines and steppers by configuration; MJX is imported when it is asked for."""

from typing import Any

import jax

from qjrl.robot import in_precision
from qjrl.robot.kinds import verb
from qjrl.robot.verbs import Robot
from qjrl.simulation.engine import Engine, EngineConfig
from qjrl.simulation.engine_stepper import EngineStepper
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.stepping import MujocoStepper, Stepper


def make_engine(robot: Robot, config: EngineConfig) -> Engine:
    """The engine that `config` names, of a robot whose numbers become float32."""
    with jax.enable_x64(False):
        single: Any = in_precision(robot, "float32")
        if config.kind == "minimal":
            return verb(single, "minimal_engine")(single, config.timestep)
        from qjrl.simulation.mjx_engine import mjx_engine

        return mjx_engine(single, config.timestep, config.kind)


def make_stepper(robot: Robot, num_sims: int, config: SettleConfig | EngineConfig) -> Stepper:
    """`num_sims` simulations on the host's side of what `config` names: C MuJoCo, or an engine of JAX."""
    if isinstance(config, EngineConfig):
        return EngineStepper(make_engine(robot, config), num_sims)
    if config.backend == "mujoco":
        return MujocoStepper(robot, num_sims, config.timestep, config.num_threads)
    return make_stepper(robot, num_sims, EngineConfig(config.backend, config.timestep))
