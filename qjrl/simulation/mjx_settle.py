"""Settle with MJX, in float32, for accelerators: chunks of simulations stepped together, each frozen once it rests."""

import dataclasses
import functools
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.progress import compiling
from qjrl.robot import build_mjcf
from qjrl.robot.verbs import Robot
from qjrl.simulation.mjx_model import (
    ArmState,
    Rows,
    balanced_step,
    compile_batch,
    load_arm,
    look,
    mjx,
    single_precision,
    tip_pose,
)
from qjrl.simulation.settle_problem import RawSettled, SettleConfig, SettleProblem

# In float32 a resting arm still shows mean |joint velocity| of up to 1.2e-4 rad/s: what counts as rest is above that.
REST_SPEED = 2e-4
# Steps between two looks of the host at which simulations still move.
_STEPS_PER_CALL = 50


@struct.dataclass
class _Row:
    """One simulation on its way to rest."""

    state: ArmState
    steps: Rows
    quiet_steps: Rows


@struct.dataclass
class _Reading:
    pose: jax.Array
    actuator_force: jax.Array


@dataclasses.dataclass(frozen=True)
class _Compiled:
    """The functions of one arm and batch size, on rows alone."""

    move: Callable[[_Row], _Row]
    look: Callable[[_Row], _Reading]


def settle_mjx(robot: Robot, problem: SettleProblem, config: SettleConfig, advance) -> RawSettled:
    """Run every row of `problem` to rest, `batch_size` at a time; rest is judged by `REST_SPEED` at least."""
    size = min(config.batch_size, max(len(problem.joint_positions), 1))
    compiled = _compile(build_mjcf(robot, config.solver), config, size)
    parts = []
    for start in range(0, len(problem.joint_positions), size):
        chosen = np.arange(start, min(start + size, len(problem.joint_positions)))
        rows = _rows(problem, np.resize(chosen, size))
        with single_precision():
            while np.asarray(_is_active(config, rows)).any():
                rows = compiled.move(rows)
            parts.append(_raw(config, rows, compiled.look(rows), len(chosen)))
        advance(len(chosen))
    fields = ("joint_positions", "pose", "strand_tension", "speed", "steps", "converged")
    return RawSettled(*(np.concatenate([getattr(part, field) for part in parts]) for field in fields))


@functools.lru_cache(maxsize=2)
def _compile(mjcf: str, config: SettleConfig, size: int) -> _Compiled:
    """Once for all shards of a data set: it takes a minute."""
    arm = load_arm(mjcf, backend=config.backend)
    zeros = lambda width: np.zeros((size, width), np.float32)  # noqa: E731
    counts = np.zeros(size, np.int32)
    state = ArmState(zeros(arm.host.nq), zeros(arm.host.nv), zeros(arm.host.nu), zeros(arm.host.nv))
    rows = _Row(state, counts, counts)
    with compiling(f"MJX to settle {size} arms"):
        move = compile_batch(partial(_move, config), (None, None, 0), arm.model, arm.data, rows)
        look = compile_batch(partial(_look, arm.tip), (None, None, 0), arm.model, arm.data, rows)
    return _Compiled(partial(move, arm.model, arm.data), partial(look, arm.model, arm.data))


def _rows(problem: SettleProblem, ids: np.ndarray) -> _Row:
    positions = np.asarray(problem.joint_positions[ids], np.float32)
    commands = np.asarray(problem.strand_commands[ids], np.float32)
    zeros, counts = np.zeros_like(positions), np.zeros(len(ids), np.int32)
    return _Row(ArmState(positions, zeros, commands, zeros), counts, counts)


def _is_active(config: SettleConfig, row: _Row) -> jax.Array:
    return (row.quiet_steps < config.hold_steps) & (row.steps < config.max_steps)


def _move(config: SettleConfig, model: mjx.Model, home: mjx.Data, row: _Row) -> _Row:
    """`_STEPS_PER_CALL` steps of one simulation; once at rest it stays as it is."""
    tolerance = max(config.rest_speed, REST_SPEED)

    def step(_, row: _Row) -> _Row:
        data = balanced_step(model, row.state.placed_in(home))
        is_quiet = jnp.mean(jnp.abs(data.qvel)) < tolerance
        quiet = jnp.where(is_quiet, row.quiet_steps + 1, 0)
        moved = _Row(row.state.moved_to(data), row.steps + 1, quiet)
        return jax.tree.map(lambda new, old: jnp.where(_is_active(config, row), new, old), moved, row)

    return jax.lax.fori_loop(0, _STEPS_PER_CALL, step, row)


def _look(tip: int, model: mjx.Model, home: mjx.Data, row: _Row) -> _Reading:
    data = look(model, row.state.placed_in(home))
    return _Reading(tip_pose(data, tip), data.actuator_force)


def _raw(config: SettleConfig, rows: _Row, reading: _Reading, count: int) -> RawSettled:
    """The first `count` rows on the host, float64."""
    wide = jax.tree.map(lambda value: np.asarray(value)[:count].astype(np.float64), (rows, reading))
    rest, seen = wide
    positions = rest.state.joint_positions
    is_finite = np.isfinite(seen.pose).all(axis=1) & np.isfinite(positions).all(axis=1)
    return RawSettled(
        joint_positions=positions,
        pose=seen.pose,
        strand_tension=np.maximum(-seen.actuator_force, 0.0),
        speed=np.abs(rest.state.joint_velocities).mean(axis=1),
        steps=rest.steps.astype(int),
        converged=is_finite & (rest.quiet_steps >= config.hold_steps),
    )
