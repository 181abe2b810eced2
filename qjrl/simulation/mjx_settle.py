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
from qjrl.simulation.relaxation import Relaxation, relaxation
from qjrl.simulation.settle_problem import RawSettled, SettleConfig, SettleProblem
from qjrl.simulation.settle_rule import approach, has_turned, mean_speed, next_loss, status, stiffness_seen

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
    turns: Rows
    loss: Rows
    """Share of the velocities that a step takes; 0 with a damping scale."""
    rest_speed: Rows
    """[rad/s]."""
    positions_then: Rows
    """At the end of the last window of steps [rad, m]; so are the next two."""
    velocities_then: Rows
    kicks_then: Rows
    """What a step changes the velocities by, before the loss [rad/s]."""


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
    """Run every row of `problem` to rest, `batch_size` at a time; rest is evaluated by `REST_SPEED` at least."""
    size = min(config.batch_size, max(len(problem.joint_positions), 1))
    stand_in = relaxation(robot, config)
    compiled = _compile(stand_in, config, size)
    parts = []
    for start in range(0, len(problem.joint_positions), size):
        chosen = np.arange(start, min(start + size, len(problem.joint_positions)))
        ids = np.resize(chosen, size)
        rows = _rows(stand_in, config, problem.joint_positions[ids], problem.strand_commands[ids])
        with single_precision():
            while np.asarray(_is_active(config, rows)).any():
                rows = compiled.move(rows)
            parts.append(_raw(config, rows, compiled.look(rows), len(chosen)))
        advance(len(chosen))
    fields = ("joint_positions", "pose", "strand_tension", "speed", "steps", "status")
    return RawSettled(*(np.concatenate([getattr(part, field) for part in parts]) for field in fields))


@functools.lru_cache(maxsize=2)
def _compile(stand_in: Relaxation, config: SettleConfig, size: int) -> _Compiled:
    """Once for all shards of a data set: it takes a minute."""
    arm = load_arm(stand_in.mjcf, backend=config.backend)
    rows = _rows(stand_in, config, np.zeros((size, arm.host.nq)), np.zeros((size, arm.host.nu)))
    with compiling(f"MJX to settle {size} arms"):
        move = compile_batch(
            partial(_move, config, stand_in.loss is not None), (None, None, 0), arm.model, arm.data, rows
        )
        look = compile_batch(partial(_look, arm.tip), (None, None, 0), arm.model, arm.data, rows)
    return _Compiled(partial(move, arm.model, arm.data), partial(look, arm.model, arm.data))


def _rows(stand_in: Relaxation, config: SettleConfig, positions: np.ndarray, commands: np.ndarray) -> _Row:
    """Simulations at rest at positions (n, nq) [rad, m], holding commands (n, strands) [m]."""
    positions, commands = np.asarray(positions, np.float32), np.asarray(commands, np.float32)
    zeros, counts, ones = (
        np.zeros_like(positions),
        np.zeros(len(positions), np.int32),
        np.ones(len(positions), np.float32),
    )
    state = ArmState(positions, zeros, commands, zeros)
    if stand_in.loss is None:
        loss, rest_speed = 0.0, config.rest_speed
    else:
        loss, rest_speed = stand_in.loss, config.rest_angle * 0.5 * stand_in.loss / config.timestep
    rest_speed = max(rest_speed, REST_SPEED) * ones
    return _Row(state, counts, counts, counts, np.float32(loss) * ones, rest_speed, positions, zeros, zeros)


def _is_active(config: SettleConfig, row: _Row) -> jax.Array:
    return (row.quiet_steps < config.hold_steps) & (row.steps < config.max_steps)


def _move(config: SettleConfig, is_adaptive: bool, model: mjx.Model, home: mjx.Data, row: _Row) -> _Row:
    """`_STEPS_PER_CALL` steps of one simulation; once at rest it stays as it is."""

    def step(_, row: _Row) -> _Row:
        data = balanced_step(model, row.state.placed_in(home))
        kicks = data.qvel - row.state.joint_velocities
        data = data.replace(qvel=data.qvel * (1.0 - row.loss))
        is_quiet = mean_speed(jnp, data.qvel) < row.rest_speed
        quiet = jnp.where(is_quiet, row.quiet_steps + 1, 0)
        positions = row.state.joint_positions
        moved = dataclasses.replace(row, state=row.state.moved_to(data), steps=row.steps + 1, quiet_steps=quiet)
        is_end = moved.steps % config.hold_steps == 0
        looked = _looked(config, is_adaptive, moved, positions, kicks)
        moved = jax.tree.map(lambda new, old: jnp.where(is_end, new, old), looked, moved)
        return jax.tree.map(lambda new, old: jnp.where(_is_active(config, row), new, old), moved, row)

    return jax.lax.fori_loop(0, _STEPS_PER_CALL, step, row)


def _looked(config: SettleConfig, is_adaptive: bool, row: _Row, positions: jax.Array, kicks: jax.Array) -> _Row:
    """One simulation at the end of a window: has it turned, and how stiff is what still moves?"""
    velocities = row.state.joint_velocities
    is_late = row.steps > config.max_steps / 2
    turns = row.turns + (is_late & has_turned(jnp, velocities, row.velocities_then))
    if is_adaptive:
        change = config.timestep * (kicks - row.kicks_then)
        stiffness = stiffness_seen(jnp, positions - row.positions_then, change)
        loss = next_loss(jnp, row.loss, stiffness)
        approaches = approach(jnp, loss, stiffness, config.max_steps)
        rest_speed = jnp.maximum(config.rest_angle * approaches / config.timestep, REST_SPEED)
        is_first = row.steps == config.hold_steps  # has no kicks to compare with
        loss, rest_speed = jnp.where(is_first, row.loss, loss), jnp.where(is_first, row.rest_speed, rest_speed)
        row = dataclasses.replace(row, loss=loss, rest_speed=rest_speed)
    return dataclasses.replace(row, turns=turns, positions_then=positions, velocities_then=velocities, kicks_then=kicks)


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
        speed=mean_speed(np, rest.state.joint_velocities),
        steps=rest.steps.astype(int),
        status=status(is_finite, rest.quiet_steps >= config.hold_steps, rest.turns),
    )
