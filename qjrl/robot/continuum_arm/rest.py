"""Where a continuum arm rests: the least energy, by Newton steps with all second derivatives.

Far from rest the energy may be curved the wrong way. There each segment steps by itself, by its rod's stiffness and that of
its taut cables, whose energy is curved the right way everywhere.
"""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float

from qjrl.geometry.vectors import Vector
from qjrl.robot.continuum_arm.energy import (
    Curvature,
    chain_of,
    curvature_of,
    energy,
    residual,
    shapes_of,
)
from qjrl.robot.continuum_arm.plant import (
    Cables,
    Plant,
    cable_lengths,
    cable_tensions,
    cables_of,
    nominal_bends,
    stretched,
)
from qjrl.robot.continuum_arm.rod import Discretisation, elastic_slopes, rotation_by
from qjrl.xla_options import jit_of_chains

LARGEST_RESIDUAL = 1e-6
"""Largest slope of the energy by any mode at which an arm counts as at rest [N m]."""
_SOUGHT_RESIDUAL = 1e-10
_MOST_STEPS = 60
_LARGEST_STEP = 0.6
_SHARES = (1.0, 0.4, 0.1, 0.01)
# What the energy may rise by in a step that is all rounding, as a share of the energy.
_ROUNDING = 1e-13


@struct.dataclass
class Rest:
    """Arms at rest, one row each."""

    pose: Float[Array, "n 9"]
    """Of the measured tip: position [m], two columns of the rotation."""
    tension: Float[Array, "n S C"]
    """Of the cables of each segment [N]."""
    modes: Float[Array, "n S size"]
    """Of each rod, in the order of `Discretisation.size`."""
    residual: Float[Array, "n"]
    """Largest slope of the energy by any mode [N m]."""
    converged: Bool[Array, "n"]
    """Whether the residual is at most `LARGEST_RESIDUAL`."""


def rest(
    plant: Plant,
    commands: Float[Array, "n S C"],
    previous: Float[Array, "n S C"],
    counts: Discretisation = Discretisation(),
) -> Rest:
    """Where the arm rests with its cables at `commands`, which it reached from the `previous` ones.

    Derivatives by the plant's numbers and by the commands, of any order, are those of the state of rest. It needs float64:
    in single precision no arm converges.

    Args:
        commands: length of each cable relative to home [m], + pays out.
    """
    modes = _modes_at_rest(counts, plant, commands, previous)
    cables = cables_of(plant, commands, previous)
    shapes = shapes_of(plant, modes, counts)
    chain = chain_of(plant, shapes)
    frame = chain.tip_rotation.product(rotation_by(Vector(*plant.tip_rotation)))
    found = jnp.max(jnp.abs(residual(plant, cables, modes, counts)), axis=(0, 1))
    return Rest(
        pose=jnp.stack(jax.tree.leaves((chain.tip, frame.x, frame.y)), axis=1),
        tension=cable_tensions(plant, cables, cable_lengths(plant, shapes)).transpose(2, 1, 0),
        modes=modes.transpose(2, 1, 0),
        residual=found,
        converged=found <= LARGEST_RESIDUAL,
    )


compiled_rest = jit_of_chains(rest, static_argnums=3)
"""`rest`, compiled; all arguments by position."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _modes_at_rest(counts: Discretisation, plant: Plant, commands: jax.Array, previous: jax.Array) -> jax.Array:
    """(size, S, n)."""
    cables = cables_of(plant, commands, previous)
    bends = nominal_bends(plant, commands)
    start = jnp.zeros((counts.size, *bends.shape[1::-1]), bends.dtype)
    start = start.at[0].set(bends[..., 0].T).at[counts.bending].set(bends[..., 1].T)
    return _search(plant, cables, start, counts)


@_modes_at_rest.defjvp
def _modes_at_rest_jvp(counts: Discretisation, primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    """The residual stays zero: its change by the arguments is made up by the modes."""
    modes = _modes_at_rest(counts, *primals)

    def at_modes(plant: Plant, commands: jax.Array, previous: jax.Array) -> jax.Array:
        return residual(plant, cables_of(plant, commands, previous), modes, counts)

    _, change = jax.jvp(at_modes, primals, tangents)
    plant = primals[0]
    matrix = _matrix(curvature_of(plant, cables_of(*primals), modes, counts))
    return modes, _solved(jnp.linalg.cholesky(matrix), -change)


@dataclasses.dataclass(frozen=True)
class _Problem:
    """What stays the same in a search."""

    plant: Plant
    cables: Cables
    counts: Discretisation

    def energy(self, modes: jax.Array) -> jax.Array:
        return energy(self.plant, self.cables, modes, self.counts)


def _search(plant: Plant, cables: Cables, start: jax.Array, counts: Discretisation) -> jax.Array:
    problem = _Problem(plant, cables, counts)

    def is_unfinished(state: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        _, largest, step = state
        return (step < _MOST_STEPS) & ~jnp.all(largest <= _SOUGHT_RESIDUAL)

    def advance(state: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        modes, _, step = state
        curvature = curvature_of(plant, cables, modes, counts)
        moved = _moved(problem, modes, _direction(problem, curvature))
        return moved, jnp.max(jnp.abs(curvature.residual), axis=(0, 1)), step + 1

    largest = jnp.full(start.shape[2], jnp.inf, start.dtype)
    return jax.lax.while_loop(is_unfinished, advance, (start, largest, 0))[0]


def _moved(problem: _Problem, modes: jax.Array, direction: jax.Array) -> jax.Array:
    """The best of a few shares of a step; the whole step where none lowers the energy by more than rounding."""
    size = jnp.max(jnp.abs(direction), axis=(0, 1))
    direction = direction * jnp.minimum(1.0, _LARGEST_STEP / jnp.maximum(size, _LARGEST_STEP))
    shares = jnp.array((0.0, *_SHARES))
    energies = jax.vmap(lambda share: problem.energy(modes + share * direction))(shares)
    rise = energies[1:] - energies[0]
    is_better = rise <= _ROUNDING * jnp.abs(energies[0])
    first = jnp.where(is_better[0], 0, jnp.argmin(jnp.where(jnp.isnan(rise), jnp.inf, rise), axis=0))
    return modes + shares[1:][first] * direction


def _direction(problem: _Problem, curvature: Curvature) -> jax.Array:
    """Newton's step (size, S, n), or that of each segment by itself where the energy is curved the wrong way."""
    lower = jnp.linalg.cholesky(_matrix(curvature))
    is_wrong = jnp.any(jnp.isnan(lower), axis=(1, 2))

    def mended() -> jax.Array:
        return jnp.where(is_wrong[:, None, None], jnp.linalg.cholesky(_stiff_matrix(problem, curvature)), lower)

    return _solved(jax.lax.cond(jnp.any(is_wrong), mended, lambda: lower), -curvature.residual)


def _matrix(curvature: Curvature) -> jax.Array:
    """All second derivatives (n, S size, S size)."""
    size, _, count, rows = curvature.blocks.shape
    pairs = zip(jax.tree.leaves(curvature.lever), jax.tree.leaves(curvature.swing), strict=True)
    coupling = -sum(
        lever.transpose(2, 1, 0)[:, :, :, None, None] * swing.transpose(2, 1, 0)[:, None, None] for lever, swing in pairs
    )
    is_before = jnp.triu(jnp.ones((count, count)), 1)[:, None, :, None]
    upper = (coupling * is_before).reshape(rows, count * size, count * size)
    return upper + upper.mT + _block_diagonal(curvature.blocks)


def _block_diagonal(blocks: jax.Array) -> jax.Array:
    """Matrices (n, S size, S size) of blocks (size, size, S, n)."""
    size, _, count, rows = blocks.shape
    placed = blocks.transpose(3, 2, 0, 1)[:, :, :, None] * jnp.eye(count)[:, None, :, None]
    return placed.reshape(rows, count * size, count * size)


def _stiff_matrix(problem: _Problem, curvature: Curvature) -> jax.Array:
    """Stiffness of each segment by itself: of its rod, and of its cables as if their lengths were linear in the modes."""
    stretch, slope, bending = stretched(problem.plant, problem.cables, curvature.lengths)
    stiffness = problem.cables.stiffness * (slope**2 + stretch * bending)
    slopes = curvature.length_slopes
    blocks = jnp.sum(stiffness * slopes[:, None] * slopes[None], axis=2)
    elastic = jnp.stack(elastic_slopes(problem.plant.stiffness, problem.counts))
    return _block_diagonal(blocks + jnp.eye(problem.counts.size)[:, :, None, None] * elastic)


def _solved(lower: jax.Array, right: jax.Array) -> jax.Array:
    """x with L L^T x = right (size, S, n), L (n, S size, S size)."""
    size, count, rows = right.shape
    flat = right.transpose(2, 1, 0).reshape(rows, count * size, 1)
    half = jax.lax.linalg.triangular_solve(lower, flat, left_side=True, lower=True)
    found = jax.lax.linalg.triangular_solve(lower, half, left_side=True, lower=True, transpose_a=True)
    return found.reshape(rows, count, size).transpose(2, 1, 0)
