"""Settle: hold cable lengths in the physics until the arm rests, and read its pose and tensions."""

import dataclasses
import logging
from collections.abc import Callable
from typing import get_args

import jax
import numpy as np
from flax import struct

from qjrl.config import ConfigError
from qjrl.field_words import show
from qjrl.robot import configuration_from_joint_positions, joint_positions, strand_commands
from qjrl.robot.kinds import kind_of, require_robot, verb
from qjrl.robot.plausibility import check_cable_lengths, real_numbers
from qjrl.robot.verbs import Robot, configuration_from_cables, within_limits
from qjrl.simulation.mujoco_settle import settle_mujoco
from qjrl.simulation.row_by_row import row_by_row
from qjrl.simulation.settle_problem import Backend, RawSettled, SettleConfig, SettleProblem, SettleStatus

log = logging.getLogger(__name__)

# Below this tension [N] a strand counts as slack.
SLACK_TENSION = 0.01
# Between two looks at the progress bar, where a kind has statics of its own.
_ROWS_AT_ONCE = 256


@struct.dataclass
class SettleResult:
    """What the physics rests at, one row a command; float64 on the host."""

    robot: Robot = struct.field(pytree_node=False)
    """Of whose kind the configuration and the strands are."""
    pose: np.ndarray
    """(n, 9) tip pose [m, -]."""
    configuration: np.ndarray
    """(n, ...) nearest configuration of the robot's kind, such as the mean bend of each segment's joints."""
    strand_tension: np.ndarray
    """(n, strands) [N], 0 where slack."""
    joint_positions: np.ndarray
    """(n, nq) [rad, m]."""
    equality_error: np.ndarray
    """(n,) largest distance of a joint position from the constraint manifold [rad, m]."""
    speed: np.ndarray
    """(n,) mean |joint velocity| at the end [rad/s]."""
    steps: np.ndarray
    """(n,) simulation steps taken."""
    converged: np.ndarray
    """(n,) at rest; False: never settled, or diverged, its other values are not to be used."""
    status: np.ndarray | None = None
    """(n,) `SettleStatus`: rests, or how it fails to."""

    @property
    def is_slack(self) -> np.ndarray:
        """(n, strands) whether a strand carries no tension."""
        return self.strand_tension < SLACK_TENSION

    @property
    def motor_force(self) -> np.ndarray:
        """(n, cables) force that each motor holds [N]: where two strands pull against each other, their difference, to
        compare with its bound. The physics does not clip it: a pose that needs more is one that the real robot does not
        reach."""
        return verb(self.robot, "motor_force")(self.robot, self.strand_tension)

    @property
    def bends(self) -> np.ndarray:
        """(n, segments, 2) of the quaternion-joint arm, whose configuration they are."""
        return self.configuration


def settle(
    robot: Robot,
    cable_lengths,
    backend: str | None = None,
    config: SettleConfig | None = None,
    advance=None,
    previous=None,
) -> SettleResult:
    """Settle the arm at each row of cable lengths, starting from its nominal pose.

    A kind with statics of its own rests by these, and of `config` only the backend is looked at.

    Args:
        robot: the arm.
        cable_lengths: (n, num_cables) [m] relative to home, + pays out.
        backend: one of `Backend`; default: the config's.
        config: tolerances, limits and sizes; default `SettleConfig()`.
        advance: called with the number of newly settled rows (a progress bar).
        previous: (n, num_cables) [m] what each row held before, for kinds whose friction remembers it; default: home.
    Raises:
        ValueError: wrong shape, non-finite lengths or such as no cable of the robot can have, unknown backend.
    """
    require_robot(robot)
    config = SettleConfig() if config is None else config
    if not isinstance(config, SettleConfig):
        raise ConfigError(f"config: got {show(config)}, allowed: a SettleConfig")
    if backend is not None:
        if backend not in get_args(Backend):
            raise ValueError(f"backend: got {backend!r}, allowed: {', '.join(get_args(Backend))}")
        config = dataclasses.replace(config, backend=backend)
    lengths = np.asarray(real_numbers(cable_lengths, "cable_lengths"), dtype=np.float64)
    if lengths.ndim != 2 or lengths.shape[1] != robot.num_cables:
        raise ValueError(f"cable_lengths: got shape {lengths.shape}, allowed: (n, {robot.num_cables})")
    if not np.all(np.isfinite(lengths)):
        raise ValueError("cable_lengths: got non-finite values, allowed: finite lengths [m]")
    check_cable_lengths(robot, lengths)
    if kind_of(robot).rest is not None:
        before = np.zeros_like(lengths) if previous is None else np.asarray(previous, np.float64)
        return _by_own_statics(robot, lengths, before, config, advance or (lambda count: None))
    problem = nominal_problem(robot, lengths)
    raw = _load_backend(config.backend)(robot, problem, config, advance or (lambda count: None))
    if not raw.converged.all():
        log.warning("settling %s: %s", robot.name, unsettled(raw.status, config))
    return _describe(robot, raw)


def _by_own_statics(
    robot: Robot, lengths: np.ndarray, previous: np.ndarray, config: SettleConfig, advance: Callable[[int], None]
) -> SettleResult:
    """In blocks, so that a progress bar moves."""
    if config.backend != "mujoco":
        raise ConfigError(
            f"simulation.backend: got {config.backend}, allowed: mujoco; robots of kind {robot.kind} rest by statics of their "
            "own, on the CPU"
        )
    found = []
    for start in range(0, len(lengths), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        found.append(verb(robot, "rest")(robot, lengths[rows], previous[rows]))
        advance(len(lengths[rows]))
    rest = jax.tree.map(lambda *parts: np.concatenate(parts), *found)
    if num_lost := int(np.sum(~rest.has_rested)):
        log.warning("settling %s: no equilibrium was found for %d of %d rows", robot.name, num_lost, len(lengths))
    zeros = np.zeros(len(lengths))
    return SettleResult(
        robot=robot,
        pose=rest.pose,
        configuration=rest.configuration,
        strand_tension=rest.strand_tension,
        joint_positions=rest.positions,
        equality_error=zeros,
        speed=zeros,
        steps=zeros.astype(int),
        converged=rest.has_rested,
        status=np.where(rest.has_rested, SettleStatus.RESTS, SettleStatus.DIVERGES),
    )


def unsettled(status: np.ndarray, config: SettleConfig) -> str:
    """How many rows of (n,) `SettleStatus` do not rest, of which kind, and the setting that helps each; one line.

    ``3 of 16 rows do not rest: 3 creep (smaller simulation.damping_scale, or null)``
    """
    kinds = [kind for kind in SettleStatus if kind != SettleStatus.RESTS]
    counts = {kind: int(np.sum(status == kind)) for kind in kinds}
    helps = _HELPS_THE_ARM_S if config.damping_scale is None else _HELPS_A_NUMBER
    parts = [f"{count} {_VERBS[kind]} ({helps[kind]})" for kind, count in counts.items() if count]
    return f"{sum(counts.values())} of {len(status)} rows do not rest: {', '.join(parts)}"


_VERBS = {SettleStatus.CREEPS: "creep", SettleStatus.OSCILLATES: "oscillate", SettleStatus.DIVERGES: "diverge"}
_HELPS_THE_ARM_S = {
    SettleStatus.CREEPS: "larger simulation.max_time",
    SettleStatus.OSCILLATES: "larger simulation.max_time",
    SettleStatus.DIVERGES: "smaller simulation.timestep",
}
_HELPS_A_NUMBER = {
    SettleStatus.CREEPS: "simulation.damping_scale=null, or smaller, or larger simulation.max_time",
    SettleStatus.OSCILLATES: "simulation.damping_scale=null, or larger",
    SettleStatus.DIVERGES: "simulation.damping_scale=null, or smaller simulation.timestep",
}


def nominal_problem(robot: Robot, lengths: np.ndarray) -> SettleProblem:
    """Start every simulation at the nominal pose: the same equilibrium as from home, in half the steps."""
    positions, commands = row_by_row(_start_and_command, robot, lengths)
    return SettleProblem(np.asarray(positions, np.float64), np.asarray(commands, np.float64))


def _start_and_command(robot: Robot, lengths: jax.Array) -> tuple[jax.Array, jax.Array]:
    start = within_limits(robot, configuration_from_cables(robot, lengths))  # commands may be beyond the reach
    return joint_positions(robot, start), strand_commands(robot, lengths)


def _load_backend(name: Backend):
    """MJX takes seconds to import: only when it is asked for."""
    if name != "mujoco":
        from qjrl.simulation.mjx_settle import settle_mjx

        return settle_mjx
    return settle_mujoco


def _describe(robot: Robot, raw: RawSettled) -> SettleResult:
    configuration, manifold = row_by_row(_configuration_and_manifold, robot, raw.joint_positions)
    return SettleResult(
        robot=robot,
        pose=raw.pose,
        configuration=configuration,
        strand_tension=raw.strand_tension,
        joint_positions=raw.joint_positions,
        equality_error=np.abs(manifold - raw.joint_positions).max(axis=1, initial=0.0),
        speed=raw.speed,
        steps=raw.steps,
        converged=raw.converged,
        status=raw.status,
    )


def _configuration_and_manifold(robot: Robot, positions: jax.Array) -> tuple[jax.Array, jax.Array]:
    configuration = configuration_from_joint_positions(robot, positions)
    return configuration, joint_positions(robot, configuration)
