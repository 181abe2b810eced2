"""The settings of the jitter study: its configuration, and every case that it plays."""

import dataclasses
from typing import Annotated

from qjrl.config import Range, configuration
from qjrl.studies.jitter.cable_models import CableModel

MJX_SERVO_ITERATIONS = 3
"""What `mjx_model.load_arm` uses where equality rows are all that binds."""
CONTROL_PERIOD, STEPS_PER_PERIOD = 0.02, 5
"""[s] for which a command is held, and the time steps in it."""
TIMESTEP = CONTROL_PERIOD / STEPS_PER_PERIOD
"""[s]."""
OWN_TOLERANCE = {"C MuJoCo": 1e-10, "MJX": 1e-6}
"""Of the solver, by engine, as the arm's MJCF and `mjx_model.load_arm` have it: float32 does not carry further."""
SERVOS, SERVOS_AS_THEY_ARE = "servos", "servos, MJX's own step"
HARD, DEFAULT = "limits, hard rows", "limits, MuJoCo's rows"
HARD_BALANCED, DEFAULT_BALANCED = "limits, hard rows, balanced", "limits, MuJoCo's rows, balanced"


@configuration
class LimitRows:
    """How hard the rows of tendon limits are."""

    time_constant: Annotated[float, Range(above=0.0, high=1.0)]
    """First number of solref [s]; MuJoCo takes two time steps at least."""
    impedance: tuple[Annotated[float, Range(above=0.0, below=1.0)], Annotated[float, Range(above=0.0, below=1.0)]]
    """First two numbers of solimp: at the limit, and 1 mm beyond it."""


@configuration
class JitterConfig:
    """Group `jitter`; all values ours: the paper (section 5.4.1, Fig. 10) is silent."""

    num_poses: Annotated[int, Range(low=1, high=1000)] = 2
    """Commands, of bends uniform in angle and direction."""
    bend_share: Annotated[float, Range(above=0.0, high=1.0)] = 0.5
    """Bends go up to this share of the arm's limit."""
    ramp_time: Annotated[float, Range(low=0.1, high=100.0)] = 1.0
    """From home to the command [s]."""
    hold_time: Annotated[float, Range(low=0.1, high=100.0)] = 5.0
    """... which is then held [s]; C MuJoCo rests after 4 s."""
    window: Annotated[float, Range(low=0.02, high=100.0)] = 1.0
    """The last so many seconds count as rest [s]."""
    half_width: Annotated[float, Range(above=0.0, high=1.0)] = 0.0001
    """Half of the range within which limits hold a strand [m], where nothing else is said."""
    half_widths: tuple[Annotated[float, Range(above=0.0, high=1.0)], ...] = (1e-5, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2)
    """... that are compared, for both kinds of rows."""
    hard: LimitRows = LimitRows(0.008, (0.9999, 0.9999))
    """As hard as the arm's own equality rows: two time steps."""
    default: LimitRows = LimitRows(0.02, (0.9, 0.95))
    """MuJoCo's own default."""
    time_constants: tuple[Annotated[float, Range(above=0.0, high=1.0)], ...] = (0.02, 0.05)
    """Of hard rows otherwise [s]."""
    impedances: tuple[Annotated[float, Range(above=0.0, below=1.0)], ...] = (0.9, 0.99, 0.999)
    """Of hard rows otherwise."""
    iterations: Annotated[int, Range(low=2, high=1000)] = 20
    """Of the solver at most, with limits."""
    iteration_counts: tuple[Annotated[int, Range(low=2, high=1000)], ...] = (3, 100)
    """... that are compared with it; MJX compiles a minute for each."""
    tolerances: tuple[Annotated[float, Range(low=0.0, high=1.0)], ...] = (1e-4, 1e-6, 1e-8, 1e-10)
    """At which the solver stops, of both engines; elsewhere it is what the engine is run with, see `OWN_TOLERANCE`."""
    averages: tuple[Annotated[int, Range(low=2, high=10_000)], ...] = (5, 25, 125)
    """Time steps of the moving averages over joint velocities."""
    force: Annotated[float, Range(above=0.0, high=1000.0)] = 1.0
    """Sideways on the tip, for the deflection [N]."""

    def __post_init__(self):
        if self.window > self.hold_time:
            raise ValueError(f"window: got {self.window}, allowed: up to hold_time = {self.hold_time}")
        most = int((self.hold_time - self.window) / TIMESTEP)
        if self.averages and max(self.averages) > most:
            raise ValueError(
                f"averages: got {max(self.averages)}, allowed: up to (hold_time - window) / time step = {most}"
            )


@dataclasses.dataclass(frozen=True)
class Case:
    """One setting of the physics."""

    cables: CableModel
    rows: LimitRows
    half_width: float
    iterations: int
    tolerance: float | None = None
    """At which the solver stops; None: `OWN_TOLERANCE`."""
    is_balanced: bool = False
    """In MJX: whether the integrator gets balanced forces."""

    def tolerance_in(self, engine: str) -> float:
        """At which this engine's solver stops."""
        return OWN_TOLERANCE[engine] if self.tolerance is None else self.tolerance


def sweeps(config: JitterConfig) -> dict[str, dict[str, Case]]:
    """Name -> label -> case; the same case may stand in several sweeps."""
    base = Case("limits", config.hard, config.half_width, config.iterations)
    change = dataclasses.replace
    soft = change(base, rows=config.default)
    servos = change(base, cables="servos", iterations=MJX_SERVO_ITERATIONS, is_balanced=True)
    hard = lambda **changes: change(base, rows=change(config.hard, **changes))  # noqa: E731
    return {
        "cables": {
            SERVOS: servos,
            SERVOS_AS_THEY_ARE: change(servos, is_balanced=False),
            HARD: base,
            HARD_BALANCED: change(base, is_balanced=True),
            DEFAULT: soft,
            DEFAULT_BALANCED: change(soft, is_balanced=True),
        },
        "half range, hard rows": _widths(base, config),
        "half range, MuJoCo's rows": _widths(soft, config),
        "time constant": {f"{1e3 * value:g} ms": hard(time_constant=value) for value in config.time_constants},
        "impedance": {f"{value:g}": hard(impedance=(value, value)) for value in config.impedances},
        "iterations": {
            f"{count}": change(base, iterations=count)
            for count in sorted({*config.iteration_counts, config.iterations})
        },
        "tolerance": {f"{value:g}": change(base, tolerance=value) for value in sorted(config.tolerances)},
    }


def all_cases(config: JitterConfig) -> list[Case]:
    """Every case of `sweeps`, once."""
    return list(dict.fromkeys(case for sweep in sweeps(config).values() for case in sweep.values()))


def deflected_cases(config: JitterConfig) -> list[Case]:
    """Those whose stiffness against a force on the tip is measured: servos, and every range."""
    found = sweeps(config)
    ranges = (*found["half range, hard rows"].values(), *found["half range, MuJoCo's rows"].values())
    return list(dict.fromkeys((found["cables"][SERVOS], *ranges)))


def _widths(base: Case, config: JitterConfig) -> dict[str, Case]:
    widths = sorted({*config.half_widths, config.half_width})
    return {f"{1e3 * width:g} mm": dataclasses.replace(base, half_width=width) for width in widths}
