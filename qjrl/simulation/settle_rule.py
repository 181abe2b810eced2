"""How each simulation is damped on its way to rest, and when it is there: adaptive dynamic relaxation.

Every time step takes a share of all velocities, the loss. All modes die away alike with the loss that damps the softest one
critically. How soft that is shows on the way: over a window of steps, the change of the force along the way moved is
the stiffness of what still moves (Underwood 1983, Computational methods for transient analysis, chapter 5). Strands that
turn slack or taut, and stops, change it by orders of magnitude, row by row.

Written for numpy and for JAX alike (`xp`), for rows on a leading axis or for one. Stiffness is per inertia and time step
squared: the square of a mode's phase in one step [rad].
"""

from typing import Any

import numpy as np

from qjrl.simulation.settle_problem import SettleStatus

Array = Any
"""Of numpy's or of JAX's."""

# The loss from one window to the next: a stiff mode seen for a moment must not stop a soft one.
_LARGEST_RISE, _LARGEST_FALL = 1.5, 2.0
LEAST_LOSS, MOST_LOSS = 1e-3, 0.5
# Turns, in the second half of the time, that tell oscillating from creeping.
_TURNS = 2


def critical_loss(xp, stiffness: Array) -> Array:
    """The loss that damps a mode critically: twice its phase in a time step."""
    return xp.clip(2.0 * xp.sqrt(xp.maximum(stiffness, 0.0)), LEAST_LOSS, MOST_LOSS)


def stiffness_seen(xp, moved: Array, change: Array) -> Array:
    """Of what moves, from the way (..., nv) moved [rad] and the change of what forces move in one step (..., nv) [rad]."""
    return -xp.sum(moved * change, axis=-1) / xp.maximum(xp.sum(moved * moved, axis=-1), 1e-30)


def next_loss(xp, loss: Array, stiffness: Array) -> Array:
    """The loss of the next window."""
    return xp.clip(critical_loss(xp, stiffness), loss / _LARGEST_FALL, loss * _LARGEST_RISE)


def approach(xp, loss: Array, stiffness: Array, max_steps: int) -> Array:
    """Share of the way to rest that a step goes: half the loss, or less where the loss is too much for the stiffness.

    Where nothing pulls back it is what would cover the way in all the time given.
    """
    return xp.maximum(xp.minimum(0.5 * loss, stiffness / loss), 1.0 / max_steps)


def mean_speed(xp, velocities: Array) -> Array:
    """Mean |joint velocity| (...) of velocities (..., nv) [rad/s]."""
    return xp.mean(xp.abs(velocities), axis=-1)


def status(is_finite: np.ndarray, is_at_rest: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """(n,) `SettleStatus` of simulations that are over, on the host."""
    moving = np.where(turns >= _TURNS, SettleStatus.OSCILLATES, SettleStatus.CREEPS)
    return np.where(is_finite, np.where(is_at_rest, SettleStatus.RESTS, moving), SettleStatus.DIVERGES)


def has_turned(xp, velocities: Array, before: Array) -> Array:
    """Whether velocities (..., nv) point back, against those of the window before."""
    return xp.sum(velocities * before, axis=-1) < 0.0
