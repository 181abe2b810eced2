"""What is simulated to bring a robot to rest: where its kind has one a stand-in, which gets there soonest.

Where a robot rests, inertia and damping do not matter. `settle_rule` damps the stand-in, so that no time constant of the
robot is left.
"""

import dataclasses

import numpy as np

from qjrl.robot import build_mjcf
from qjrl.robot.kinds import kind_of
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settle_rule import critical_loss

STIFFEST = 1.0
"""Phase of the stiffest mode at home in one time step [rad]; from 2 on the integration is unstable."""


@dataclasses.dataclass(frozen=True)
class Relaxation:
    """What the engines simulate."""

    mjcf: str
    """Of the stand-in, or of the robot itself with more damping."""
    loss: float | None
    """Share of the velocities that a time step takes at first, see `settle_rule`; None: the joints' damping is all there is."""


def relaxation(robot: Robot, config: SettleConfig) -> Relaxation:
    """The stand-in; the robot itself where its kind has none, or with a number for `damping_scale`, which multiplies its
    joints' damping."""
    stand_in = kind_of(robot).stand_in
    if config.damping_scale is not None or stand_in is None:
        return Relaxation(build_mjcf(robot, config.solver), None)
    found = stand_in(robot, config.solver, STIFFEST)
    return Relaxation(found.mjcf, float(critical_loss(np, np.float64(found.slowest * config.timestep**2))))
