"""Two ways to move the arm by its strands, what is played on them, and what is recorded of it."""

import dataclasses
from collections.abc import Callable
from typing import Literal

import jax
import numpy as np

from qjrl.robot import build_mjcf, strand_commands
from qjrl.robot.quaternion_arm.arm import require_arm
from qjrl.robot.quaternion_arm.limited_strands import held_strand_lengths, limit_strands
from qjrl.robot.solver_options import SolverOptions
from qjrl.robot.verbs import Robot
from qjrl.simulation.row_by_row import row_by_row

CableModel = Literal["servos", "limits"]
"""The strands: elastic, pulled by servos and never pushing; or held within a range by tendon limits."""
# Width, midpoint and power of MuJoCo's solimp.
_IMPEDANCE_SHAPE = (0.001, 0.5, 2.0)


@dataclasses.dataclass(frozen=True)
class StrandLimits:
    """How the rows of limited strands are set, one value a simulation; means nothing to servos."""

    half_width: np.ndarray
    """(n,) half of the range [m]."""
    time_constant: np.ndarray
    """(n,) first number of solref [s]; MuJoCo takes two time steps at least."""
    impedance: np.ndarray
    """(n, 2) at the limit and 1 mm beyond it: the first two numbers of solimp."""

    @property
    def solref(self) -> np.ndarray:
        """(n, 2), critically damped."""
        return np.stack([self.time_constant, np.ones_like(self.time_constant)], axis=1)

    @property
    def solimp(self) -> np.ndarray:
        """(n, 5)."""
        return np.concatenate([self.impedance, np.tile(_IMPEDANCE_SHAPE, (len(self.impedance), 1))], axis=1)

    def around(self, centres):
        """`tendon_range` (n, strands, 2) [m] around centres (n, strands)."""
        return centres[..., None] + np.array([-1.0, 1.0]) * self.half_width[:, None, None]


@dataclasses.dataclass(frozen=True)
class Play:
    """Many simulations of one arm, all from rest at home, and the commands that they get."""

    robot: Robot
    cables: CableModel
    cable_lengths: np.ndarray
    """(periods, n, cables) commanded [m] relative to home."""
    limits: StrandLimits
    tolerance: np.ndarray
    """(n,) at which the constraint solver stops."""
    iterations: int
    """... and after so many at most."""
    timestep: float = 0.004
    """[s]."""
    steps_per_period: int = 5
    """Time steps for which a command is held."""

    @property
    def num_sims(self) -> int:
        """n."""
        return self.cable_lengths.shape[1]

    @property
    def mjcf(self) -> str:
        """Of the arm with these cables."""
        mjcf = build_mjcf(self.robot, SolverOptions(self.timestep, solver_iterations=self.iterations))
        return limit_strands(mjcf) if self.cables == "limits" else mjcf

    @property
    def strand_targets(self) -> np.ndarray:
        """(periods, n, strands) [m]: rest lengths of the servos, or the middles of the ranges."""
        arm = require_arm(self.robot, "jitter")
        verb: Callable[..., jax.Array] = held_strand_lengths if self.cables == "limits" else strand_commands
        periods, count, cables = self.cable_lengths.shape
        return row_by_row(verb, arm, self.cable_lengths.reshape(-1, cables)).reshape(periods, count, -1)


@dataclasses.dataclass(frozen=True)
class Recording:
    """What the simulations did."""

    joint_velocities: np.ndarray
    """(n, steps, nv) after every time step [rad/s, m/s], float32; NaN from where a simulation diverged."""
    tip: np.ndarray
    """(n, 3) position at the end [m]; NaN where it diverged."""
