"""The paper's protocol for inverse kinematics (paper 000, section 5.2, Table 3): targets, solvers, what is measured."""

import dataclasses
import math
import time
from collections.abc import Callable
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import Range, configuration
from qjrl.robot import bends_from_angles, forward_kinematics, load_robot
from qjrl.robot.quaternion_arm.fabrik import watch_fabrik
from qjrl.robot.verbs import Robot
from qjrl.solvers import (
    FabrikConfig,
    LeastSquaresConfig,
    SolveResult,
    draw_candidates,
    solve_fabrik,
    solve_least_squares,
)
from qjrl.solvers.least_squares import RoundConfig


@configuration
class CaseConfig:
    """An arm and the range its targets are drawn from; the arm's own joint limits hold besides."""

    robot: str
    """Name of a shipped arm or path of its YAML."""
    largest_angle_deg: Annotated[float, Range(above=0.0, below=90.0)]
    """theta of the targets is uniform from 0 to this, phi from 0 to 360 degrees."""

    @property
    def label(self) -> str:
        return f"{self.robot} ±{self.largest_angle_deg:g}°"


@configuration
class Table3Config:
    """Group `table3`; ours where a field names no section of the paper."""

    cases: tuple[CaseConfig, ...] = (
        CaseConfig("qj_2222", 30.0),
        CaseConfig("qj_huang_4332", 30.0),
        CaseConfig("qj_2222", 70.0),
    )
    """The paper's case, which the figures show too; Huang's arm, for which the paper quotes 77.6 %; up to the arm's limits."""
    num_targets: Annotated[int, Range(2, 1_000_000)] = 1000
    """Of each seed (paper 000, section 5.2)."""
    num_seeds: Annotated[int, Range(1, 1000)] = 5
    """Sets of targets; the spread is over them."""
    num_single: Annotated[int, Range(1, 100_000)] = 100
    """Targets that are also solved one at a time, for their time."""
    num_repeats: Annotated[int, Range(1, 100)] = 2
    """Timed solves of every batch."""
    num_curve: Annotated[int, Range(2, 100_000)] = 1000
    """Targets of the curve of success."""
    relaxations: tuple[Annotated[float, Range(above=0.0, high=10.0)], ...] = (0.5, 1.0, 2.0, 4.0)
    """lambda of each curve of success against outer iterations."""
    reversal: Annotated[float, Range(above=0.0, high=1.0)] = 0.3
    """Of the variant of FABRIK that turns back where it stalls."""
    fabrik: FabrikConfig = FabrikConfig()
    least_squares: LeastSquaresConfig = LeastSquaresConfig(least_tension=0.0, batch_size=256)
    """The same settings for all cases: kinematics alone."""

    def __post_init__(self):
        if not self.cases:
            raise ValueError("cases: got [], allowed: at least one")


Solver = Callable[[np.ndarray], SolveResult]


@dataclasses.dataclass(frozen=True)
class Measured:
    """One solver on one case; the first axis of the arrays is the seed."""

    case: str
    method: str
    results: tuple[SolveResult, ...]
    batch_seconds: np.ndarray
    """(seeds, repeats) per pose, all targets in one call."""
    single_seconds: np.ndarray
    """(num_single,) one call a target, of the first seed."""


def solvers_of(robot: Robot, config: Table3Config) -> dict[str, Solver]:
    """Every solver of the table by name: targets (n, 9) -> result. All but the last start from home, as the paper does."""
    candidates = draw_candidates(robot, config.least_squares)
    home = np.zeros((robot.num_segments, 2))
    turning_back = dataclasses.replace(config.fabrik, reversal=config.reversal)
    one_start = dataclasses.replace(config.least_squares, rounds=(_longest_single(config.least_squares),))
    return {
        "FABRIK": lambda targets: solve_fabrik(robot, targets, home, config.fabrik),
        "FABRIK, turning back": lambda targets: solve_fabrik(robot, targets, home, turning_back),
        "FABRIK, polished": lambda targets: _polish(
            robot, targets, solve_fabrik(robot, targets, home, config.fabrik), one_start, candidates
        ),
        "least squares, one start": lambda targets: solve_least_squares(robot, targets, home, one_start, candidates),
        "least squares": lambda targets: solve_least_squares(robot, targets, None, config.least_squares, candidates),
    }


def draw_targets(robot: Robot, case: CaseConfig, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Poses (count, 9) of random bends, and the bend angles (count, segments) [rad] they come from."""
    key_direction, key_angle = jax.random.split(jax.random.key(seed))
    shape = (count, robot.num_segments)
    directions = jax.random.uniform(key_direction, shape, maxval=2.0 * math.pi)
    angles = jax.random.uniform(key_angle, shape, maxval=math.radians(case.largest_angle_deg))
    bends = bends_from_angles(directions, angles)
    return np.asarray(jax.jit(jax.vmap(lambda row: forward_kinematics(robot, row)))(bends)), np.asarray(angles)


def measure_case(config: Table3Config, case: CaseConfig, seed: int, advance=None) -> list[Measured]:
    """Every solver on every seed's targets of a case; nothing that is timed is compiled in that time."""
    robot = load_robot(case.robot)
    sets = [draw_targets(robot, case, config.num_targets, seed + number)[0] for number in range(config.num_seeds)]
    measured = []
    for name, solve in solvers_of(robot, config).items():
        measured.append(_measure(case, name, solve, sets, config))
        if advance:
            advance()
    return measured


def success_curves(config: Table3Config, seed: int) -> dict[float, np.ndarray]:
    """Share of the first case's targets that FABRIK has reached after 1, 2, ... outer iterations, by relaxation."""
    case = config.cases[0]
    robot = load_robot(case.robot)
    targets, _ = draw_targets(robot, case, config.num_curve, seed)
    curves = {}
    for relaxation in config.relaxations:
        progress = watch_fabrik(robot, targets, config=dataclasses.replace(config.fabrik, relaxation=relaxation))
        is_inside = np.max(progress.arm.angles, axis=1) <= float(robot.bend_limit)
        turns = np.asarray(progress.turns)[np.asarray(progress.is_near) & is_inside]
        counts = np.bincount(turns, minlength=config.fabrik.outer_iterations + 1)[1:]
        curves[relaxation] = np.cumsum(counts) / len(targets)
    return curves


def _polish(robot: Robot, targets, found: SolveResult, config: LeastSquaresConfig, candidates) -> SolveResult:
    """Least squares from FABRIK's answers; the steps of both are counted."""
    polished = solve_least_squares(robot, targets, found.bends, config, candidates)
    return jax.tree.map(jnp.asarray, dataclasses.replace(polished, steps=polished.steps + found.steps))


def _longest_single(config: LeastSquaresConfig) -> RoundConfig:
    return RoundConfig(1, max(one_round.iterations for one_round in config.rounds))


def _measure(case: CaseConfig, name: str, solve: Solver, sets: list[np.ndarray], config: Table3Config) -> Measured:
    results = tuple(solve(targets) for targets in sets)
    batch = [[_seconds(solve, targets) / len(targets) for _ in range(config.num_repeats)] for targets in sets]
    solve(sets[0][:1])
    single = [_seconds(solve, sets[0][row : row + 1]) for row in range(min(config.num_single, len(sets[0])))]
    return Measured(case.label, name, results, np.array(batch), np.array(single))


def _seconds(solve: Solver, targets: np.ndarray) -> float:
    start = time.perf_counter()
    jax.block_until_ready(solve(targets))
    return time.perf_counter() - start
