"""What a kind of robot is: a record of functions of (robot, ...), each of one sample.

Every kind has a configuration, an array of whatever shape suits it, and offers what it can. A function that a kind lacks is
None in its record; who needs it asks through `qjrl.robot.verbs`, which says so in one line.

Coordinates are a configuration as one row of numbers (num_coordinates,) that is regular everywhere within the limits:
what descents step in. For most kinds they are the configuration itself.
"""

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import jax

from qjrl.robot.at_rest import AtRest
from qjrl.robot.drawing import Drawing
from qjrl.robot.interface import Interface
from qjrl.robot.limits import Limits
from qjrl.robot.particulars import Particulars
from qjrl.robot.tip import Tip, tip_by_differentiation


class Robot:
    """What the pytrees of all kinds have in common; a kind's own numbers are known to its own folder alone."""

    kind: ClassVar[str]
    """Its key in `qjrl.robot.kinds.KINDS`."""
    config: Any
    """The description of its numbers, made of them on the host: they stand in the pytree alone."""
    name: Any
    num_cables: Any
    """Cables, each driven by one motor."""
    num_strands: Any
    """Actuators of the MJCF: what pulls."""
    num_positions: Any
    """Joint positions of the MJCF."""
    motor_speed: Any
    """Largest cable speed [m/s]."""
    motor_force: Any
    """Largest force of a motor [N]."""
    strand_friction: Any
    """Dry friction along a strand [N]."""
    payload: Any
    """Mass at the tip [kg]."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


# Fields of a kind that are no functions of a robot.
_NO_VERBS = ("description", "make", "check", "configuration_name", "senses_configuration")


@dataclasses.dataclass(frozen=True)
class StandIn:
    """What is simulated in a robot's place until it rests: the same forces, another inertia, no damping."""

    mjcf: str
    slowest: float
    """Squared angular frequency of its slowest mode at home [1/s^2]."""


@dataclasses.dataclass(frozen=True)
class Kind:
    """One kind of robot. Shapes: configuration c, coordinates (n,), cable lengths (num_cables,) [m], pose (9,) [m, -]."""

    description: type
    """What its YAML may hold."""
    make: Callable[[Any], Robot]
    """The robot of a description."""
    home: Callable[[Any], jax.Array]
    """robot -> configuration at which all cable lengths are zero."""
    limits: Callable[[Any], Limits]
    """robot -> limits of its coordinates."""
    forward_kinematics: Callable[..., jax.Array]
    """(robot, configuration) -> pose of the tip in the base frame."""
    from_unit_cube: Callable[..., jax.Array]
    """(robot, numbers (n,) in [0, 1)) -> configuration, evenly over what the limits allow: for data sets."""
    largest: Callable[..., jax.Array]
    """robot -> largest size of a configuration's numbers within the limits, for each or for all: what scales them."""
    random: Callable[..., jax.Array]
    """(robot, key) -> configuration within the limits: for test poses and for starts."""
    configuration_name: str = "configuration"
    """What the columns of data sets call a configuration."""
    senses_configuration: bool = True
    """Whether encoders tell a configuration, so that data sets hold it and models may learn its correction."""
    check: Callable[..., None] | None = None
    """(robot, configurations (n, ...), on the host, their name) raises a ConfigError where no robot of this kind can have one."""
    to_coordinates: Callable[..., jax.Array] | None = None
    """(robot, configuration) -> coordinates; None: its numbers in a row."""
    from_coordinates: Callable[..., jax.Array] | None = None
    """(robot, coordinates) -> configuration; None: of the same numbers."""
    tip: Callable[..., Tip] | None = None
    """(robot, coordinates (n, *batch)) -> tip and Jacobian; None: by differentiation."""
    plain_poses: Callable[..., jax.Array] | None = None
    """(robot, configurations (batch, ...)) -> poses (batch, 9), of operations on whole arrays alone: for other formats."""
    within_limits: Callable[..., jax.Array] | None = None
    """(robot, configuration) -> the configuration brought back within the limits; None: through its coordinates."""
    at_distance: Callable[..., jax.Array] | None = None
    """(robot, key, distance [m]) -> configuration whose tip is so far from its place at home."""
    cable_lengths: Callable[..., jax.Array] | None = None
    """(robot, configuration) -> cable lengths relative to home, + pays out."""
    configuration_from_cables: Callable[..., jax.Array] | None = None
    """(robot, cable lengths) -> configuration, closed form."""
    cable_strokes: Callable[..., jax.Array] | None = None
    """robot -> largest |cable length| within the limits (num_cables,) [m]."""
    strand_lengths: Callable[..., jax.Array] | None = None
    """(robot, configuration) -> lengths of the strands (num_strands,) [m]."""
    strand_commands: Callable[..., jax.Array] | None = None
    """(robot, cable lengths) -> controls of the MJCF (num_strands,)."""
    motor_force: Callable[..., Any] | None = None
    """(robot, strand tensions (..., num_strands) [N]) -> force of each motor (..., num_cables) [N]."""
    equilibrium: Callable[..., Any] | None = None
    """(robot, cable lengths) -> where it rests and what would move it from there."""
    at_pretension: Callable[..., Robot] | None = None
    """(robot, tension of the strands at home [N]) -> the robot with it."""
    rest: Callable[..., AtRest] | None = None
    """(robot, cable lengths (n, num_cables), those held before them), on the host -> where it rests by statics of its own: a
    simulated robot, whose hidden defects no model sees. None: MuJoCo settles it."""
    measured: Callable[..., jax.Array] | None = None
    """(robot, key, pose) -> the pose as it is measured, with noise; None: exactly."""
    strand_tension: Callable[..., jax.Array] | None = None
    """(robot, cable lengths, steps) -> tension of the strands at rest (num_strands,) [N]."""
    encoders: Callable[..., tuple[int, ...]] | None = None
    """robot -> how many joint encoders each row of a configuration is the mean of; None: one for each of its numbers."""
    excess: Callable[..., jax.Array] | None = None
    """(robot, configuration) -> how far any joint is beyond its mechanical stop [rad], below 0 within; None: never."""
    is_at_strength: Callable[..., Any] | None = None
    """(robot, tensions) -> whether the real strands would break."""
    build_mjcf: Callable[..., str] | None = None
    """(robot, SolverOptions) -> MuJoCo XML."""
    stand_in: Callable[..., StandIn] | None = None
    """(robot, SolverOptions, phase of the stiffest mode in a time step [rad]) -> what settles in its place; None: itself."""
    minimal_engine: Callable[..., Any] | None = None
    """(robot, float32, time step [s]) -> its own equations of motion as an engine, see `simulation.engine`."""
    joint_positions: Callable[..., jax.Array] | None = None
    """(robot, configuration) -> joint positions of the MJCF (num_positions,)."""
    configuration_from_joint_positions: Callable[..., jax.Array] | None = None
    """(robot, joint positions) -> nearest configuration."""
    drawing: Drawing | None = None
    """How it is drawn."""
    interface: Interface | None = None
    """What it shows to controllers outside."""
    particulars: Particulars | None = None
    """What it says of itself beside what all kinds do."""
    reach: Callable[..., float] | None = None
    """robot -> distance from the base that no tip goes far beyond [m]."""
    cable_names: Callable[..., tuple[str, ...]] | None = None
    """robot -> names of the cables (num_cables,)."""
    strand_names: Callable[..., tuple[str, ...]] | None = None
    """robot -> names of the strands (num_strands,)."""

    def shape_of(self, robot: Any) -> tuple[int, ...]:
        """Shape of the robot's configuration."""
        return self.home(robot).shape

    def configuration_of(self, robot: Any, coordinates: jax.Array) -> jax.Array:
        """The configuration of coordinates (n,)."""
        if self.from_coordinates is not None:
            return self.from_coordinates(robot, coordinates)
        return coordinates.reshape(self.shape_of(robot))

    def coordinates_of(self, robot: Any, configuration: jax.Array) -> jax.Array:
        """The coordinates (n,) of a configuration."""
        if self.to_coordinates is not None:
            return self.to_coordinates(robot, configuration)
        return configuration.reshape(-1)

    def tip_of(self, robot: Any, coordinates: jax.Array) -> Tip:
        """The tip at coordinates (n, *batch), and its Jacobian."""
        if self.tip is not None:
            return self.tip(robot, coordinates)
        return tip_by_differentiation(
            lambda one: self.forward_kinematics(robot, self.configuration_of(robot, one)), coordinates
        )

    def offers(self) -> tuple[str, ...]:
        """Names of the functions that it has."""
        names = [field.name for field in dataclasses.fields(self)]
        return tuple(name for name in names if name not in _NO_VERBS and getattr(self, name) is not None)
