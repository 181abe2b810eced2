"""What an engine is: the physics of many arms of one robot as pure functions, home, advance and read; a row an arm.

Engines are pytrees, arguments of compiled programs: numbers of the robot are leaves, the time step is static.
"""

from typing import Annotated, Any, Literal, Protocol, runtime_checkable

import jax

from qjrl.config import Range, configuration
from qjrl.robot.plant import PhysicalParameters, PlantState

EngineKind = Literal["minimal", "mjx", "mjx-warp"]
"""The arm's own equations in minimal coordinates; MJX in JAX's operations or in the kernels of NVIDIA's Warp.

C MuJoCo is none: it would ask the host at every step, at a quarter of the rate. It evaluates."""


@configuration
class EngineConfig:
    """Group `engine`: what policies train in; ours."""

    kind: EngineKind = "minimal"
    """See `EngineKind`. On a CPU the arm's own equations are several times quicker."""
    timestep: Annotated[float, Range(low=1e-4, high=0.02)] = 0.005
    """Time step [s]; the control period is a multiple of it. The rest pose does not depend on it."""


@runtime_checkable
class Engine(Protocol):
    """The contract of all engines."""

    robot: Any
    timestep: float

    def home(self, parameters: PhysicalParameters) -> Any:
        """The state of arms with these parameters, at rest at home and holding their cables there."""
        ...

    def placed(self, state: Any, joint_positions: jax.Array, strand_commands: jax.Array) -> Any:
        """The arms of `home` at rest at joint positions (n, nq) [rad, m], holding rest lengths (n, strands) [m]."""
        ...

    def advance(self, state: Any, strand_commands: jax.Array, num_steps: int | jax.Array) -> Any:
        """`num_steps` time steps on, holding rest lengths (n, strands) [m]; an arm that diverges stays where it was."""
        ...

    def read(self, state: Any) -> PlantState:
        """What the arms show."""
        ...
