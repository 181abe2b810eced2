"""The engine of a configuration, as a stepper."""

from qjrl.robot.verbs import Robot
from qjrl.simulation.minimal_stepping import TIMESTEP, MinimalStepper
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.stepping import MujocoStepper, Stepper


def make_stepper(robot: Robot, num_sims: int, config: SettleConfig, is_minimal: bool = False) -> Stepper:
    """`num_sims` simulations on the engine that `config` names, or in minimal coordinates; MJX is imported when asked for."""
    if is_minimal:
        return MinimalStepper(robot, num_sims, num_threads=config.num_threads)
    if config.backend != "mujoco":
        from qjrl.simulation.mjx_stepping import MjxStepper

        return MjxStepper(robot, num_sims, config.timestep, config.backend)
    return MujocoStepper(robot, num_sims, config.timestep, config.num_threads)


def timestep_of(config: SettleConfig, is_minimal: bool = False) -> float:
    """Time step [s] of the stepper that `make_stepper` makes."""
    return TIMESTEP if is_minimal else config.timestep
