"""Play cable trajectories in the physics, feed-forward alone, and evaluate how the tip follows its path."""

import dataclasses
import math
from collections.abc import Sequence
from functools import partial
from typing import Annotated

import jax
import numpy as np

from qjrl.config import Range, configuration
from qjrl.control.path.inversion import PathInversionConfig, path_errors
from qjrl.control.path.paths import PosePath, ShapeConfig
from qjrl.control.tracking.trajectory import CableTrajectory, MotionLimits, straight_path, time_path
from qjrl.robot import joint_positions, strand_commands
from qjrl.robot.plant import PhysicalParameters
from qjrl.robot.verbs import Robot, home
from qjrl.simulation.control_period import substeps_of
from qjrl.simulation.engines import make_stepper
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.stepping import Stepper


@configuration
class TrackConfig:
    """Group `track`; all values ours: the paper holds single poses."""

    path: str = "circle"
    """"circle", "line", or a .csv or .npz file of poses, see `qjrl.control.path.paths.make_path`."""
    shape: ShapeConfig = ShapeConfig()
    """Of the circle, the line; orientation; distance of waypoints."""
    inversion: PathInversionConfig = PathInversionConfig()
    """How the redundancy is used."""
    limits: MotionLimits = MotionLimits()
    """Of every cable, beside the motors' speed."""
    speed: Annotated[float, Range(above=0.0, high=1.0)] = 0.5
    """Share of the feasible speed."""
    compared_speeds: tuple[Annotated[float, Range(above=0.0, high=1.0)], ...] = (0.25, 1.0)
    """Played beside it, for the table."""
    period: Annotated[float, Range(low=0.004, high=0.2)] = 0.02
    """Of the commands [s]; 50 Hz (paper 000, section 4)."""
    lead: Annotated[float, Range(low=0.0, high=0.2)] | None = None
    """By how much commands run ahead of the plan [s]; null: by the lag that a rehearsal without lead shows."""
    accepted_error: Annotated[float, Range(above=0.0)] = 1e-3
    """99th percentile of the position error that the report calls good [m]."""
    least_tension: Annotated[float, Range(low=0.0)] = 0.5
    """What every strand is to keep at rest along the path [N]; a path that does not is not played."""


@dataclasses.dataclass(frozen=True)
class Performance:
    """A trajectory as the motors are told it."""

    trajectory: CableTrajectory
    lead: float = 0.0
    """By how much commands run ahead of the plan, to make up for the arm's lag [s]."""
    is_held: bool = False
    """Motors jump to every command and hold it for a period, instead of moving to it evenly over the period."""


@dataclasses.dataclass(frozen=True)
class Played:
    """What the physics made of a performance, at every time step of the physics."""

    time: np.ndarray
    """(n,) since the start of the plan [s]."""
    command: np.ndarray
    """(n, num_cables) [m]."""
    pose: np.ndarray
    """(n, 9) of the tip [m, -]."""
    joint_positions: np.ndarray
    """(n, nq)."""
    strand_tension: np.ndarray
    """(n, strands) [N]."""
    rest_speed: float
    """Mean |joint velocity| where the plan began [rad/s]."""
    is_finite: bool
    """Whether the simulation stayed finite."""

    @property
    def motor_force(self) -> np.ndarray:
        """(n, num_cables) force of every motor: the difference of its loop's two strands [N]."""
        return self.strand_tension[:, 0::2] - self.strand_tension[:, 1::2]


@dataclasses.dataclass(frozen=True)
class TrackingErrors:
    """Of the tip against the plan, at every time of a `Played`."""

    position: np.ndarray
    """(n,) distance from where it should be now [m]."""
    orientation: np.ndarray
    """(n,) angle from how it should stand now [rad]; 0 where orientation does not count."""
    across: np.ndarray
    """(n,) distance from the path: the part of the position error across the direction of travel [m]."""
    along: np.ndarray
    """(n,) behind the plan (-) or ahead (+), along the direction of travel [m]."""
    speed: np.ndarray
    """(n,) of the planned tip [m/s]."""


def play(
    robot: Robot,
    simulation: SettleConfig,
    performances: Sequence[Performance],
    period: float,
    limits: MotionLimits,
    advance=None,
) -> list[Played]:
    """Ramp every arm from home to the start of its plan, wait until all rest, then play, side by side.

    Args:
        period: of the commands [s].
        limits: of the ramp.
        advance: called with the number of control periods played.
    """
    stepper = make_stepper(robot, len(performances), simulation)
    substeps = substeps_of(period, stepper.timestep)
    _approach(robot, stepper, performances, limits, simulation)
    rest_speed = np.abs(stepper.read().joint_velocities).mean(axis=1)
    first = -math.ceil(max(one.lead for one in performances) / period) - 1
    last = math.ceil((max(one.trajectory.duration for one in performances) + _AFTER) / period)
    times = first * period + stepper.timestep * np.arange(1, (last - first) * substeps + 1)
    lengths = np.stack([_motor_lengths(one, times, stepper.timestep, period) for one in performances])
    strands, records = _strands(robot, lengths), []
    for number in range(len(times)):
        stepper.step(strands[:, number], 1)
        records.append(_record(stepper))
        if advance and number % substeps == 0:
            advance(1)
    stacked = {name: np.stack([record[name] for record in records], axis=1) for name in records[0]}
    is_finite = stepper.read().is_sound
    return [
        Played(
            times,
            lengths[index],
            **{name: rows[index] for name, rows in stacked.items()},
            rest_speed=float(rest_speed[index]),
            is_finite=bool(is_finite[index]),
        )
        for index in range(len(performances))
    ]


def evaluate(plan: CableTrajectory, path: PosePath, played: Played) -> TrackingErrors:
    """Errors against the plan, while it moves."""
    distance = plan.distances(played.time)
    wanted = path.at(distance)
    position, orientation = path_errors(path.constraint, played.pose, wanted)
    before, behind = np.maximum(distance - _STEP, 0.0), np.minimum(distance + _STEP, path.length)
    tangent = (path.at(behind)[:, :3] - path.at(before)[:, :3]) / (behind - before)[:, None]
    size = np.linalg.norm(tangent, axis=1)
    missed = played.pose[:, :3] - wanted[:, :3]
    along = np.sum(missed * tangent, axis=1) / np.maximum(size, 1e-9)
    across = np.sqrt(np.maximum(position**2 - along**2, 0.0))
    return TrackingErrors(position, orientation, across, along, size * plan.distances(played.time, 1))


def _motor_lengths(one: Performance, times: np.ndarray, timestep: float, period: float) -> np.ndarray:
    """Cable lengths (n, cables) that the motors hold in the time steps that end at `times` [s].

    The command sent at the begin of a period is where to be at its end, or where to jump at once.
    """
    middle = times - timestep / 2.0
    begin = period * np.floor(middle / period)
    sent = one.trajectory.at(begin + one.lead)
    if one.is_held:
        return sent
    return sent + ((middle - begin) / period)[:, None] * (one.trajectory.at(begin + period + one.lead) - sent)


def _approach(
    robot: Robot, stepper: Stepper, performances: Sequence[Performance], limits: MotionLimits, simulation: SettleConfig
) -> None:
    """From rest at home to rest at the begin of the plans."""
    count, speed = len(performances), float(robot.motor_speed)
    start = np.asarray(joint_positions(robot, home(robot)))
    home_lengths = np.zeros(robot.num_cables)
    at_home = _strands(robot, np.tile(home_lengths, (count, 1, 1)))[:, 0]
    stepper.reset(np.arange(count), np.tile(start, (count, 1)), at_home, PhysicalParameters.nominal(robot, count))
    starts = [one.trajectory.at(np.zeros(1))[0] for one in performances]
    ramps = [time_path(straight_path(start), speed, limits, _CALM) if start.any() else None for start in starts]
    longest = max(one.duration if one else 0.0 for one in ramps)  # a plan that begins at home needs none
    times = stepper.timestep * np.arange(1, max(1, math.ceil(longest / stepper.timestep)) + 1)
    strands = _strands(
        robot, np.stack([one.at(times) if one else np.tile(home_lengths, (len(times), 1)) for one in ramps])
    )
    for number in range(len(times)):
        stepper.step(strands[:, number], 1)
    quiet = 0
    for _ in range(simulation.max_steps):
        stepper.step(strands[:, -1], 1)
        is_quiet = np.abs(stepper.read().joint_velocities).mean(axis=1).max() < simulation.speed_tolerance
        quiet = quiet + 1 if is_quiet else 0
        if quiet >= simulation.hold_steps:
            return


def _strands(robot: Robot, lengths: np.ndarray) -> np.ndarray:
    """Rest lengths (arms, n, strands) of the strands for cable lengths (arms, n, cables) [m]."""
    rows = _strand_rows(robot, lengths.reshape(-1, lengths.shape[-1]))
    return np.asarray(rows).reshape(*lengths.shape[:2], -1)


@jax.jit
def _strand_rows(robot: Robot, rows: jax.Array) -> jax.Array:
    return jax.vmap(partial(strand_commands, robot))(rows)


def _record(stepper: Stepper) -> dict[str, np.ndarray]:
    """Copies of what lasts."""
    readout = stepper.read()
    names = ("pose", "joint_positions", "strand_tension")
    return {name: np.array(getattr(readout, name), np.float64) for name in names}


# How long a play goes on after the plan's end [s]; how quick the ramp from home is, against the quickest.
_AFTER, _CALM = 0.2, 0.5
# Of the distance along the path, to find the direction of travel [m].
_STEP = 1e-5
