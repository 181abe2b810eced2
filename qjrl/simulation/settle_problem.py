"""What a settling engine is given and gives back, and the numbers it works by."""

import dataclasses
import enum
import math
from typing import Annotated, Literal

import numpy as np

from qjrl.config import NotIdentity, Range, configuration
from qjrl.robot.solver_options import SolverOptions

Backend = Literal["mujoco", "mjx", "mjx-warp"]
"""C MuJoCo on the CPU's cores; MJX, float32, for accelerators, in JAX's operations or in the kernels of NVIDIA's Warp."""


@configuration
class SettleConfig:
    """How to settle (group `simulation`); all values ours.

    With the shipped values inertia and damping follow from the arm, row by row (`relaxation`, `settle_rule`), whatever its
    size: the arm's own time constants do not matter. A looser speed tolerance, allowed, stops further away.
    """

    backend: Backend = "mujoco"
    """The engine, see `Backend`."""
    timestep: Annotated[float, Range(low=1e-4, high=0.006)] = 0.004
    """Time step [s]; half of it moves the settled tip by less than 0.02 mm."""
    speed_tolerance: Annotated[float, Range(above=0.0, high=0.1)] = 1e-4
    """At rest: mean |joint velocity| below this [rad/s] in 5 ms; see `rest_angle` and, with a damping scale, `rest_speed`.
    A row stops 0.5 microradians from where it would end."""
    hold_time: Annotated[float, Range(above=0.0, high=10.0)] = 0.05
    """... for this long [s]; also between two looks at how a row moves."""
    max_time: Annotated[float, Range(above=0.0, high=600.0)] = 24.0
    """What does not rest by then is flagged [s of simulated time]. A row takes 0.4 s in the mean, one with all strands slack 16."""
    damping_scale: Annotated[float, Range(low=0.1, high=100.0)] | None = None
    """None: from the arm. A number: the arm's own inertia, and its joints' damping so many times, from the first step to the
    last; it must suit the arm."""
    batch_size: Annotated[int, Range(low=1, high=65536), NotIdentity(lambda config: config.backend == "mujoco")] = 256
    """Simulations side by side. C MuJoCo settles a row alone; compiled for another size, MJX may differ in the last bits."""
    num_threads: Annotated[int, Range(low=0, high=1024), NotIdentity()] = 0
    """Threads of C MuJoCo; 0 = all cores."""

    def __post_init__(self):
        if self.hold_time >= self.max_time:
            raise ValueError(f"hold_time: got {self.hold_time}, allowed: less than max_time = {self.max_time}")

    @property
    def solver(self) -> SolverOptions:
        """The physics' numerical settings with a damping scale: armature grows with the joints' damping, and the strands' shrinks.
        Implicit damping weakens the forces of rows as damping * timestep / inertia, until they chatter."""
        scale = 1.0 if self.damping_scale is None else self.damping_scale
        return SolverOptions(
            self.timestep,
            damping_scale=scale,
            armature_scale=min(max(0.5 * scale, 1.0), 10.0),
            strand_damping_scale=0.1,
            lumping=2,
        )

    @property
    def rest_angle(self) -> float:
        """What is left of the way where a row counts as at rest, mean |joint angle| [rad]."""
        return 0.005 * self.speed_tolerance

    @property
    def rest_speed(self) -> float:
        """Mean |joint velocity| that counts as rest with a damping scale [rad/s]: with s times the damping, what is left to
        move creeps s times slower."""
        return self.speed_tolerance / max(self.damping_scale or 1.0, 1.0)

    @property
    def hold_steps(self) -> int:
        """Consecutive steps at rest that count as settled."""
        return math.ceil(self.hold_time / self.timestep)

    @property
    def max_steps(self) -> int:
        """Steps after which a simulation is given up."""
        return math.ceil(self.max_time / self.timestep)


class SettleStatus(enum.IntEnum):
    """How a simulation ended."""

    RESTS = 0
    CREEPS = 1
    """Still moves, one way."""
    OSCILLATES = 2
    """Still moves, to and fro."""
    DIVERGES = 3
    """No numbers any more."""


@dataclasses.dataclass(frozen=True)
class SettleProblem:
    """What a backend needs: where each simulation starts and what its actuators hold."""

    joint_positions: np.ndarray
    """(n, nq) start [rad, m]."""
    strand_commands: np.ndarray
    """(n, strands) rest lengths [m]."""


@dataclasses.dataclass(frozen=True)
class RawSettled:
    """What a backend reads off at the end, one row a simulation."""

    joint_positions: np.ndarray
    pose: np.ndarray
    strand_tension: np.ndarray
    speed: np.ndarray
    steps: np.ndarray
    status: np.ndarray

    @property
    def converged(self) -> np.ndarray:
        return self.status == SettleStatus.RESTS
