"""The engine of `simulation.backend`, as a stepper."""

from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.stepping import MujocoStepper, Stepper


def make_stepper(robot: Robot, num_sims: int, config: SettleConfig) -> Stepper:
    """`num_sims` simulations on the engine that `config` names; MJX is imported when it is asked for."""
    if config.backend == "mjx":
        from qjrl.simulation.mjx_stepping import MjxStepper

        return MjxStepper(robot, num_sims, config.timestep)
    return MujocoStepper(robot, num_sims, config.timestep, config.num_threads)
