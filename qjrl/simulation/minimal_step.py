"""One time step of many arms in minimal coordinates: linearly implicit, with strands that pull only, dry friction, stops.

The coordinates are the half angles of `robot.quaternion_arm.dynamics`. Stiffness and damping are implicit, so the time
step may be as long as the control period, and the rest pose does not depend on it:

    (M + h D + h^2 K) v' = M v + h (gravity - Coriolis - hinge springs - J^T tension) + J^T impulses.

Friction of a strand and the stop of a joint are rows of that system with bounded impulses, so that a strand that
friction holds does not creep. Projected Gauss-Seidel sweeps find them, from the last step's impulses on.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.geometry import cholesky
from qjrl.robot.quaternion_arm.description import QuaternionArm
from qjrl.robot.quaternion_arm.dynamics import Equations, Load, equations_of_motion, hinge_damping, hinge_stiffness

# Gauss-Seidel sweeps of a step; impulses are carried over, so they go on converging from step to step.
SWEEPS = 8


@struct.dataclass
class MinimalState:
    """What the next step depends on; lanes last."""

    half_angles: Any
    """(segments, 2, lanes) [rad]."""
    rates: Any
    """(segments, 2, lanes) [rad/s]."""
    impulses: Any
    """(strands + segments, lanes) of friction and stops in the last step [N s]; where the sweeps begin."""


@struct.dataclass
class Physics:
    """What may differ between lanes."""

    load: Load
    strand_stiffness: Any
    """(strands, lanes) [N/m]."""
    strand_damping: Any
    """(lanes,) [N s/m]."""
    strand_friction: Any
    """(lanes,) [N]."""


def minimal_steps(
    arm: QuaternionArm,
    physics: Physics,
    state: MinimalState,
    commands: jax.Array,
    timestep: jax.Array,
    num_steps: jax.Array,
) -> MinimalState:
    """`num_steps` steps of `timestep` [s] on, holding rest lengths `commands` (strands, lanes) [m]."""
    return jax.lax.fori_loop(0, num_steps, lambda _, state: _step(arm, physics, state, commands, timestep), state)


def strand_tension(arm: QuaternionArm, physics: Physics, lengths: jax.Array, commands: jax.Array) -> jax.Array:
    """(strands, lanes) [N]: a spring that pulls up to the strand's strength and never pushes."""
    return jnp.clip(physics.strand_stiffness * (lengths - commands), 0.0, arm.config.strands.strength)


def _step(
    arm: QuaternionArm, physics: Physics, state: MinimalState, commands: jax.Array, timestep: jax.Array
) -> MinimalState:
    equations = equations_of_motion(arm, physics.load, state.half_angles, state.rates)
    tension = strand_tension(arm, physics, equations.strands, commands)
    lower, free = _without_rows(arm, physics, equations, state, tension, timestep)
    rows = jnp.concatenate([equations.strand_slope, equations.cosine_slope], axis=1)  # (coordinates, rows, lanes)
    room = (equations.cosines - _stop_cosine(arm)) / timestep
    friction = jnp.broadcast_to(timestep * physics.strand_friction, tension.shape)
    least = jnp.concatenate([-friction, jnp.zeros_like(room)])
    most = jnp.concatenate([friction, jnp.full_like(room, jnp.inf)])
    offset = jnp.concatenate([jnp.zeros_like(tension), room])
    rates, impulses = _sweep(lower, free, rows, offset, least, most, state.impulses)
    rates = rates.reshape(state.rates.shape)
    return MinimalState(state.half_angles + timestep * rates, rates, impulses)


def _without_rows(arm: QuaternionArm, physics: Physics, equations: Equations, state: MinimalState, tension, timestep):
    """Cholesky factor of the implicit matrix, and the rates that it gives without friction and stops."""
    spring, damper = (
        jnp.asarray(values, tension.dtype)[:, None] for values in (hinge_stiffness(arm), hinge_damping(arm))
    )
    is_spring = (tension > 0.0) & (tension < arm.config.strands.strength)
    slope = equations.strand_slope
    resisted = slope * (timestep * physics.strand_damping + timestep**2 * physics.strand_stiffness * is_spring)
    diagonal = timestep * damper + timestep**2 * spring
    size = len(slope)
    matrix = [
        [
            equations.mass[i, j] + jnp.sum(resisted[i] * slope[j], axis=0) + (diagonal[i] if i == j else 0.0)
            for j in range(i + 1)
        ]
        for i in range(size)
    ]
    angles, rates = (value.reshape(size, -1) for value in (state.half_angles, state.rates))
    force = equations.force - spring * angles - jnp.sum(slope * tension, axis=1)
    lower = cholesky.factor(matrix)
    return lower, cholesky.solve(lower, jnp.sum(equations.mass * rates[None], axis=1) + timestep * force)


def _sweep(lower, rates, rows, offset, least, most, impulses):
    """Rates with row . rates = -offset wherever the row's impulse is within its bounds, and the impulses."""
    answers = cholesky.solve(lower, rows)  # (coordinates, rows, lanes): rates that a unit impulse gives
    gain = 1.0 / jnp.maximum(jnp.sum(rows * answers, axis=0), 1e-12)
    impulses = jnp.clip(impulses, least, most)
    rates = rates + jnp.sum(answers * impulses, axis=1)

    def once(_, carry):
        rates, impulses = carry
        found = []
        for row in range(rows.shape[1]):
            velocity = jnp.sum(rows[:, row] * rates, axis=0) + offset[row]
            found.append(jnp.clip(impulses[row] - gain[row] * velocity, least[row], most[row]))
            rates = rates + answers[:, row] * (found[row] - impulses[row])
        return rates, jnp.stack(found)

    return jax.lax.fori_loop(0, SWEEPS, once, (rates, impulses))


def _stop_cosine(arm: QuaternionArm) -> float:
    """cos(theta/2) at the mechanical stop."""
    joint = arm.config.joint
    return math.cos(math.radians(joint.bend_limit_deg + joint.stop_margin_deg) / 2.0)
