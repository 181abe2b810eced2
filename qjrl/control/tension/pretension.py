"""The least pretension that keeps every strand taut, and what each pretension costs.

A strand loses tension where rolling joints shorten its path, where gravity and the joints' stiffness pull the arm off its
nominal pose, and where its partner of the loop carries the load. More pretension lifts all strands, but it loads the
motors and, since tense strands push a bent joint further, drives the arm towards its stops until it buckles.
"""

import dataclasses
from typing import Annotated

import numpy as np

from qjrl.config import Range, configuration
from qjrl.control.tension.path import path_poses
from qjrl.control.tension.poses import Law, PoseSet, workspace_poses
from qjrl.control.tension_check import TensionCheck, check_tension
from qjrl.geometry.pose import row_errors
from qjrl.keys import seed_for
from qjrl.robot.kinds import verb
from qjrl.robot.verbs import Robot
from qjrl.simulation.rested import require_rest
from qjrl.simulation.settle_problem import SettleConfig

Newtons = Annotated[float, Range(low=0.0, high=1e5)]


@configuration
class PretensionConfig:
    """Group `pretension`; all values ours."""

    least_tension: Annotated[float, Range(low=0.01, high=1e4)] = 2.0
    """What every strand is to carry at rest [N]; ours."""
    share: Annotated[float, Range(above=0.0, high=1.0)] = 1.0
    """Share of the poses that are to be safe: taut, within motors and strength, at rest."""
    law: Law = "even"
    """Of the poses over the workspace: "even" over each segment's disc of bends, or "uniform" in angle."""
    rim_share: Annotated[float, Range(low=0.0, high=1.0)] = 0.25
    """Share of those poses with all segments at their limits, in random directions. There the strands that cross all joints
    lose most, and hardly a random pose comes near; ours."""
    num_poses: Annotated[int, Range(8, 1_000_000)] = 512
    """Poses over the workspace, powers of two are the most even; of a path, at most so many of its rows or waypoints."""
    path: str | None = None
    """A .csv or .npz of cable lengths or poses to look at instead of the workspace, see `qjrl.control.tension.path.read_path`."""
    pretensions: tuple[Newtons, ...] = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 60.0, 100.0, 150.0)
    """Of the curve [N], rising; the search goes up to the last. The robot's own is added."""
    resolution: Annotated[float, Range(above=0.0, high=100.0)] = 0.25
    """The answer is a multiple of this [N]."""
    num_angles: Annotated[int, Range(1, 90)] = 7
    """Bends of a single segment up to the limit, for its map."""
    num_directions: Annotated[int, Range(3, 360)] = 16
    """Directions of a single segment's bend, for its map."""

    def __post_init__(self):
        if len(self.pretensions) < 2 or any(np.diff(self.pretensions) <= 0.0):
            raise ValueError(f"pretensions: got {list(self.pretensions)}, allowed: at least two, rising")


@dataclasses.dataclass(frozen=True)
class Survey:
    """The same poses at every pretension of the curve."""

    poses: PoseSet
    checks: dict[float, TensionCheck]
    """Pretension [N] -> what it does, rising."""

    @property
    def lowest_tension(self) -> np.ndarray:
        """(pretensions, n) tension of each pose's least loaded strand [N], NaN where it does not settle."""
        return np.stack([lowest_tension(check) for check in self.checks.values()])

    @property
    def num_falling(self) -> int:
        """Poses whose least loaded strand loses more than 0.1 N somewhere on the way up."""
        return int((np.diff(self.lowest_tension, axis=0) < -0.1).any(axis=0).sum())


@dataclasses.dataclass(frozen=True)
class Choice:
    """What the search found."""

    pretension: float | None
    """The least that is enough [N]; None: none of the curve's is."""
    too_little: float
    """The largest that was found not to be enough, next below the answer [N]."""
    at: float
    """The answer, or without one the curve's pretension that keeps most poses [N]."""
    check: TensionCheck
    """All poses at `at`, settled from their nominal poses."""
    num_settled: int
    """Poses settled by the search, besides the curve's."""


def at_pretension(robot: Robot, pretension: float) -> Robot:
    """The robot with another pretension [N]: another robot, for which nothing is compiled again."""
    return verb(robot, "at_pretension")(robot, float(pretension))


def poses_to_keep(robot: Robot, config: PretensionConfig, seed: int) -> PoseSet:
    """The path's rows where the configuration names one, else poses all over the workspace.

    Raises:
        ConfigError: as `path_poses`.
    """
    if config.path is not None:
        return path_poses(robot, config.path, config.num_poses, seed)
    return workspace_poses(robot, config.law, config.num_poses, seed, config.rim_share)


def fresh_poses(robot: Robot, config: PretensionConfig, seed: int) -> PoseSet:
    """As many other poses over the workspace, to hold the answer against."""
    return workspace_poses(
        robot, config.law, config.num_poses, seed_for(seed, "fresh poses of the pretension"), config.rim_share
    )


def curve_of(robot: Robot, config: PretensionConfig) -> tuple[float, ...]:
    """The pretensions to look at [N]: the configuration's and the robot's own."""
    return tuple(sorted({*config.pretensions, float(robot.pretension)}))


def survey(robot: Robot, config: PretensionConfig, simulation: SettleConfig, poses: PoseSet, advance=None) -> Survey:
    """Settle all poses at every pretension of the curve, each from its nominal pose.

    Args:
        advance: called with the number of newly settled poses.
    Raises:
        ConfigError: no pose rests with the robot's own pretension.
    """
    checks = {
        pretension: _check(robot, config, simulation, pretension, poses.cable_lengths, advance)
        for pretension in curve_of(robot, config)
    }
    own = checks[float(robot.pretension)].rest.converged
    require_rest(own, "pretension: poses at the robot's own pretension")
    return Survey(poses, checks)


def choose(robot: Robot, config: PretensionConfig, simulation: SettleConfig, found: Survey, advance=None) -> Choice:
    """Halve the interval below the curve's first pretension that is enough, then settle all poses at the answer.

    While halving, only the poses are settled that the lower end does not keep: a strand that is taut stays so with more
    pretension. Where that turns out wrong, the search goes on above.
    """
    pretensions = list(found.checks)
    enough = [number for number in pretensions if _is_enough(config, found.checks[number].is_safe)]
    if not enough:
        closest = max(pretensions, key=lambda number: found.checks[number].is_safe.mean())
        return Choice(None, pretensions[-1], closest, found.checks[closest], 0)
    low = max((number for number in pretensions if number < enough[0]), default=0.0)
    unsafe = ~found.checks[low].is_safe if low in found.checks else np.ones(len(found.poses), bool)
    bracket = _Bracket(low, enough[0], unsafe, 0)
    while True:
        bracket = _halve(robot, config, simulation, found.poses, bracket)
        check, settled = found.checks.get(bracket.high), bracket.num_settled
        if check is None:
            check = _check(robot, config, simulation, bracket.high, found.poses.cable_lengths, advance)
            settled += len(found.poses)
        if _is_enough(config, check.is_safe):
            return Choice(bracket.high, bracket.low, bracket.high, check, settled)
        bracket = _Bracket(bracket.high, enough[0], ~check.is_safe, settled)


def lowest_tension(check: TensionCheck) -> np.ndarray:
    """(n,) tension of each pose's least loaded strand [N], NaN where it does not settle."""
    return np.where(check.rest.converged, check.rest.strand_tension.min(axis=1), np.nan)


def off_nominal(check: TensionCheck, poses: PoseSet) -> np.ndarray:
    """(n,) distance of the tip from the closed form's [m], NaN where it does not settle."""
    return np.where(check.rest.converged, row_errors(check.rest.pose, poses.nominal_pose)[0], np.nan)


def needed_pretension(config: PretensionConfig, found: Survey) -> np.ndarray:
    """(n,) pretension at which each pose's least loaded strand reaches the stated tension [N], by linear interpolation.

    NaN where no pretension of the curve does; the lowest where the first already does. Up to one step of the curve too low
    where the strand is slack at the step's lower end.
    """
    pretensions, tension = np.array(list(found.checks)), found.lowest_tension
    is_taut = tension >= config.least_tension
    first = is_taut.argmax(axis=0)
    before, rows = np.maximum(first - 1, 0), np.arange(tension.shape[1])
    gain = tension[first, rows] - tension[before, rows]
    share = np.where(gain > 0.0, (config.least_tension - tension[before, rows]) / np.where(gain > 0.0, gain, 1.0), 1.0)
    needed = pretensions[before] + np.where(np.isnan(share), 1.0, share) * (pretensions[first] - pretensions[before])
    return np.where(is_taut.any(axis=0), needed, np.nan)


def _is_enough(config: PretensionConfig, is_safe: np.ndarray) -> bool:
    return bool(is_safe.mean() >= config.share)


@dataclasses.dataclass(frozen=True)
class _Bracket:
    low: float
    """Not enough [N]."""
    high: float
    """Enough, as far as has been seen [N]."""
    unsafe: np.ndarray
    """(n,) the poses that the lower end does not keep."""
    num_settled: int


def _halve(
    robot: Robot, config: PretensionConfig, simulation: SettleConfig, poses: PoseSet, bracket: _Bracket
) -> _Bracket:
    """The bracket at the resolution's width."""
    while (middle := _middle(bracket.low, bracket.high, config.resolution)) is not None:
        check = _check(robot, config, simulation, middle, poses.cable_lengths[bracket.unsafe])
        unsafe = bracket.unsafe.copy()
        unsafe[bracket.unsafe] = ~check.is_safe
        settled = bracket.num_settled + len(check.is_safe)
        if _is_enough(config, ~unsafe):
            bracket = dataclasses.replace(bracket, high=middle, num_settled=settled)
        else:
            bracket = _Bracket(middle, bracket.high, unsafe, settled)
    return bracket


def _check(
    robot: Robot,
    config: PretensionConfig,
    simulation: SettleConfig,
    pretension: float,
    lengths: np.ndarray,
    advance=None,
) -> TensionCheck:
    return check_tension(at_pretension(robot, pretension), lengths, config.least_tension, simulation, advance)


def _middle(low: float, high: float, resolution: float) -> float | None:
    """The multiple of the resolution nearest to the middle; None where there is none in between."""
    middle = resolution * round((low + high) / (2.0 * resolution))
    return middle if low < middle < high else None
