"""One time step of many arms in minimal coordinates: linearly implicit, with strands that pull only, dry friction, stops.

The coordinates are the half angles of `robot.quaternion_arm.dynamics`. Stiffness and damping are implicit, so the time
step may be as long as the control period, and the rest pose does not depend on it:

    (M + h D + h^2 K) v' = M v + h (gravity - Coriolis - hinge springs - J^T tension) + J^T impulses.

Friction of a strand and the stop of a joint are rows of that system with bounded impulses, so that a strand that
friction holds does not creep. Projected Gauss-Seidel sweeps find them, from the last step's impulses on.
"""

import functools
import itertools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.geometry import cholesky
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.dynamics import Equations, Load, equations_of_motion, hinge_damping, hinge_stiffness

# Gauss-Seidel sweeps of a step; impulses are carried over, so they go on converging from step to step.
SWEEPS = 8
# On a CPU: with more arms than MOST_AT_ONCE a step goes through blocks of about BLOCK, whose numbers a core's cache holds.
MOST_AT_ONCE, BLOCK = 512, 256


@struct.dataclass
class MinimalState:
    """What the next step depends on; the batch last."""

    half_angles: Any
    """(segments, 2, batch) [rad]."""
    rates: Any
    """(segments, 2, batch) [rad/s]."""
    impulses: Any
    """(strands + segments, batch) of friction and stops in the last step [N s]; where the sweeps begin."""


@struct.dataclass
class Physics:
    """What may differ between the arms of a batch."""

    load: Load
    strand_stiffness: Any
    """(strands, batch) [N/m]."""
    strand_damping: Any
    """(batch,) [N s/m]."""
    strand_friction: Any
    """(batch,) [N]."""


def minimal_steps(
    arm: QuaternionArm,
    physics: Physics,
    state: MinimalState,
    commands: jax.Array,
    timestep: jax.Array,
    num_steps: jax.Array,
) -> MinimalState:
    """`num_steps` steps of `timestep` [s] on, holding rest lengths `commands` (strands, batch) [m]."""

    def steps(physics: Physics, state: MinimalState, commands: jax.Array) -> MinimalState:
        return jax.lax.fori_loop(0, num_steps, lambda _, now: _step(arm, physics, now, commands, timestep), state)

    if jax.default_backend() != "cpu":
        return steps(physics, state, commands)
    return in_blocks(steps, (physics, state, commands), commands.shape[-1])


def in_blocks(function: Callable, arguments: tuple, batch_size: int) -> Any:
    """function(*arguments), trees of (..., batch), block after block where there are more than a core's cache holds."""
    if batch_size <= MOST_AT_ONCE:
        return function(*arguments)
    count = math.ceil(batch_size / BLOCK)
    size = math.ceil(batch_size / count)
    places = np.minimum(np.arange(count * size), batch_size - 1)  # the last block goes on with copies of the last arm

    def cut(values: jax.Array) -> jax.Array:
        whole = values if count * size == batch_size else values[..., places]
        return jnp.moveaxis(whole.reshape(*whole.shape[:-1], count, size), -2, 0)

    def join(values: jax.Array) -> jax.Array:
        return jnp.moveaxis(values, 0, -2).reshape(*values.shape[1:-1], count * size)[..., :batch_size]

    return jax.tree.map(join, jax.lax.map(lambda block: function(*block), jax.tree.map(cut, arguments)))


def strand_tension(arm: QuaternionArm, physics: Physics, lengths: jax.Array, commands: jax.Array) -> jax.Array:
    """(strands, batch) [N]: a spring that pulls up to the strand's strength and never pushes."""
    return jnp.clip(physics.strand_stiffness * (lengths - commands), 0.0, arm.strand_strength)


def _step(
    arm: QuaternionArm, physics: Physics, state: MinimalState, commands: jax.Array, timestep: jax.Array
) -> MinimalState:
    equations = equations_of_motion(arm, physics.load, state.half_angles, state.rates)
    tension = strand_tension(arm, physics, equations.strands, commands)
    lower, free = _without_rows(arm, physics, equations, state, tension, timestep)
    room = (equations.cosines - jnp.cos(arm.stop / 2.0)) / timestep
    friction = jnp.broadcast_to(timestep * physics.strand_friction, tension.shape)
    least = jnp.concatenate([-friction, jnp.zeros_like(room)])
    most = jnp.concatenate([friction, jnp.full_like(room, jnp.inf)])
    reduced = _reduced_rows(arm, lower, equations)
    free, impulses = _sweep(free, reduced, room, least, most, state.impulses)
    rates = jnp.stack(cholesky.back(lower, free)[::-1]).reshape(state.rates.shape)
    return MinimalState(state.half_angles + timestep * rates, rates, impulses)


def _without_rows(arm: QuaternionArm, physics: Physics, equations: Equations, state: MinimalState, tension, timestep):
    """L of the implicit matrix L L^T, and L^T times the rates without friction and stops; the last coordinate first.

    In this order the rows of the first segments' strands, which the coordinates after do not move, begin with zeros.
    """
    spring, damper = (
        jnp.asarray(values, tension.dtype)[:, None] for values in (hinge_stiffness(arm), hinge_damping(arm))
    )
    is_spring = (tension > 0.0) & (tension < arm.strand_strength)
    slope = equations.strand_slope
    resistance = timestep * physics.strand_damping + timestep**2 * physics.strand_stiffness * is_spring
    diagonal = timestep * damper + timestep**2 * spring
    size = len(slope)
    moved = [slope[i, _strands_moved(arm, i)] for i in range(size)]
    resisted = [moved[i] * resistance[_strands_moved(arm, i)] for i in range(size)]

    def entry(i: int, j: int) -> jax.Array:
        moving = moved[j][len(moved[j]) - len(moved[i]) :]
        implicit = equations.mass[i, j] + jnp.sum(resisted[i] * moving, axis=0)
        return implicit + diagonal[i] if i == j else implicit

    order = range(size)[::-1]
    lower = cholesky.factor([[entry(max(i, j), min(i, j)) for j in order[: k + 1]] for k, i in enumerate(order)])
    angles, rates = (value.reshape(size, -1) for value in (state.half_angles, state.rates))
    pull = jnp.stack([jnp.sum(moved[i] * tension[_strands_moved(arm, i)], axis=0) for i in range(size)])
    momentum = jnp.sum(equations.mass * rates[None], axis=1)
    right = momentum + timestep * (equations.force - spring * angles - pull)
    return lower, jnp.stack(cholesky.forward(lower, [right[i] for i in order]))


def _reduced_rows(arm: QuaternionArm, lower, equations: Equations) -> list[jax.Array]:
    """L^-1 times each row, strands before stops, without the zeros that it begins with.

    A row's velocity is their product with L^T rates, which an impulse of the row moves along them.
    """
    size, count = len(lower), arm.num_segments
    strands = arm.num_strands // count
    by_segment = []
    for segment in range(count):
        begin, own = size - 2 * (segment + 1), slice(strands * segment, strands * (segment + 1))
        coordinates = range(2 * (segment + 1))[::-1]
        right = [
            jnp.concatenate([equations.strand_slope[k, own], equations.cosine_slope[k, segment : segment + 1]])
            for k in coordinates
        ]
        by_segment.append(jnp.stack(cholesky.forward([row[begin:] for row in lower[begin:]], right)))
    rows = [values[:, place] for values in by_segment for place in range(strands)]
    return rows + [values[:, strands] for values in by_segment]


def _sweep(free, rows, room, least, most, impulses):
    """L^T rates with row . rates = -offset wherever the row's impulse is within its bounds, and the impulses."""
    offset = jnp.concatenate([jnp.zeros((len(rows) - len(room), *room.shape[1:]), room.dtype), room])
    gain = jnp.stack([1.0 / jnp.maximum(jnp.sum(row * row, axis=0), 1e-12) for row in rows])
    impulses = jnp.clip(impulses, least, most)
    runs = [list(run) for _, run in itertools.groupby(range(len(rows)), lambda place: len(rows[place]))]

    def pushed(free, impulses):
        for run in runs:
            still = len(free) - len(rows[run[0]])
            push = functools.reduce(jnp.add, [rows[place] * impulses[place] for place in run])
            free = jnp.concatenate([free[:still], free[still:] + push])
        return free

    def once(_, carry):
        free, impulses = carry
        found = []
        for run in runs:
            still = len(free) - len(rows[run[0]])
            moving = free[still:]
            for place in run:
                velocity = jnp.sum(rows[place] * moving, axis=0) + offset[place]
                found.append(jnp.clip(impulses[place] - gain[place] * velocity, least[place], most[place]))
                moving = moving + rows[place] * (found[-1] - impulses[place])
            free = jnp.concatenate([free[:still], moving])
        return free, jnp.stack(found)

    return jax.lax.fori_loop(0, SWEEPS, once, (pushed(free, impulses), impulses))


def _strands_moved(arm: QuaternionArm, coordinate: int) -> slice:
    """Those of its own segment and of all after it."""
    return slice(arm.num_strands // arm.num_segments * (coordinate // 2), None)
