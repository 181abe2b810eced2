"""A path from its poses to what the arm made of it: invert, check the tensions, time, rehearse, play, evaluate."""

import dataclasses
import logging
from collections.abc import Mapping

import numpy as np

from qjrl.config import ConfigError
from qjrl.control.path.errors import path_errors
from qjrl.control.path.inversion import CablePath, invert_path
from qjrl.control.path.paths import PosePath, make_path
from qjrl.control.tension_check import TensionCheck, check_tension
from qjrl.control.tracking.playing import Performance, Played, TrackConfig, TrackingErrors, evaluate, play
from qjrl.control.tracking.trajectory import CableTrajectory, time_path
from qjrl.robot.pose_model import PoseFunction, model_poses, or_closed_form
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is to be played."""

    path: PosePath
    cables: CablePath
    trajectory: CableTrajectory
    model_error: tuple[np.ndarray, np.ndarray]
    """Position [m] and orientation [rad] error (n,) on the model at every command."""
    rest: TensionCheck
    """The path's places at rest in the physics."""
    rest_error: tuple[np.ndarray, np.ndarray]
    """Their position [m] and orientation [rad] error: the model's own."""


@dataclasses.dataclass(frozen=True)
class Evaluated:
    """One performance and what became of it."""

    performance: Performance
    played: Played
    errors: TrackingErrors

    @property
    def is_moving(self) -> np.ndarray:
        """(n,) times that count: from the plan's begin to its end."""
        return (self.played.time >= 0.0) & (self.played.time <= self.performance.trajectory.duration)


def make_plan(
    robot: Robot, model: PoseFunction | None, simulation: SettleConfig, config: TrackConfig, seed: int
) -> Plan:
    """The trajectory of a configuration, its tensions checked at rest before anything moves.

    Raises:
        ConfigError: a path that is no path, that cannot be reached, or that would slacken a strand or exceed a motor.
    """
    path = make_path(config.path, config.shape, robot=robot)
    cables = invert_path(robot, model, path, config.inversion, seed)
    trajectory = time_path(cables.lengths, float(robot.motor_speed), config.limits, config.speed)
    places = np.linspace(0.0, path.length, _NUM_RESTS)
    rest = check_tension(robot, cables.lengths(places), config.least_tension, simulation)
    if not rest.is_safe.all():
        raise ConfigError(
            f"track.path: {rest.message}; rows are {_NUM_RESTS} places even along the path's {path.length:.3g} m"
        )
    moved = trajectory.distances(command_times(trajectory, config.period))
    poses = model_poses(or_closed_form(robot, model), cables.lengths(moved))
    return Plan(
        path,
        cables,
        trajectory,
        path_errors(path.constraint, poses, path.at(moved)),
        rest,
        path_errors(path.constraint, rest.rest.pose, path.at(places)),
    )


def nominal_plan(robot: Robot, plan: Plan, config: TrackConfig, seed: int) -> CablePath | None:
    """The same path inverted on the closed form, to compare with; None where the closed form cannot reach it."""
    try:
        return invert_path(robot, None, plan.path, config.inversion, seed)
    except ConfigError as error:
        log.info("track: the closed form is not compared: %s", error)
        return None


def num_periods(config: TrackConfig, plan: Plan) -> int:
    """About how many control periods `perform` plays, for a progress bar."""
    slowest = min(config.speed, *config.compared_speeds, 1.0)
    return int((plan.trajectory.quickest / config.speed + plan.trajectory.quickest / slowest) / config.period)


def command_times(trajectory: CableTrajectory, period: float) -> np.ndarray:
    """Times of the plan's commands [s]; the last is at its end or the first after it."""
    return period * np.arange(int(np.ceil(trajectory.duration / period)) + 1)


def perform(
    robot: Robot,
    simulation: SettleConfig,
    config: TrackConfig,
    plan: Plan,
    nominal: CablePath | None,
    advance=None,
) -> dict[str, Evaluated]:
    """The plan played, under the name "planned", and beside it what it is to be compared with.

    Args:
        nominal: the same path inverted on the closed form, to be played too.
        advance: called with the number of control periods played.
    """
    rehearsal = {"without lead": Performance(plan.trajectory)}
    evaluated = _played(robot, simulation, config, plan.path, rehearsal, advance)
    lead = config.lead
    if lead is None:
        lead = max(0.0, _lag(evaluated["without lead"]))
        log.info("track: the tip lags %.2f ms behind; commands lead by as much", 1e3 * lead)
    speed, limits = float(robot.motor_speed), config.limits
    shows = {
        "planned": Performance(plan.trajectory, lead),
        "held commands": Performance(plan.trajectory, lead + config.period / 2.0, is_held=True),
    }
    if nominal is not None:
        shows["closed form"] = Performance(time_path(nominal.lengths, speed, limits, config.speed), lead)
    for share in config.compared_speeds:
        shows[f"at {share:g} of the feasible speed"] = Performance(
            dataclasses.replace(plan.trajectory, speed=share), lead
        )
    return _played(robot, simulation, config, plan.path, shows, advance) | evaluated


def _lag(evaluated: Evaluated) -> float:
    """Time by which the tip is behind, from a fit of its distance behind to its speed [s]."""
    speed, along = evaluated.errors.speed[evaluated.is_moving], evaluated.errors.along[evaluated.is_moving]
    return float(-(along @ speed) / max(speed @ speed, 1e-300))


def _played(
    robot: Robot,
    simulation: SettleConfig,
    config: TrackConfig,
    path: PosePath,
    shows: Mapping[str, Performance],
    advance,
) -> dict[str, Evaluated]:
    played = play(robot, simulation, list(shows.values()), config.period, config.limits, advance)
    return {
        name: Evaluated(performance, one, evaluate(performance.trajectory, path, one))
        for (name, performance), one in zip(shows.items(), played, strict=True)
    }


# Places along the path where the arm is settled before it moves.
_NUM_RESTS = 65
