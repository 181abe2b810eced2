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
from jaxtyping import Array, Float

from qjrl.geometry.vectors import Vector
from qjrl.robot.continuum_arm.energy import (
    Curvature,
    chain_of,
    curvature_of,
    energy_and_residual,
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
_MOST_TRIES = 100
_LARGEST_STEP = 0.6
_SHORTER = 0.3
_GOOD_SHARE = 0.1
# What the energy may rise by in a step that is all rounding, as a share of the energy.
_ROUNDING = 1e-13
# Fall of the energy that a whole step promises near to rest, as a share of EI / L.
_NEAR = 1e-9


@struct.dataclass
class Rest:
    """Arms at rest, one row each."""

    pose: Any
    """(n, 9) of the measured tip: position [m], two columns of the rotation."""
    tension: Any
    """(n, S, C) of the cables of each segment [N]."""
    modes: Any
    """(n, S, size) of each rod, in the order of `Discretisation.size`."""
    residual: Any
    """(n,) largest slope of the energy by any mode [N m]."""
    converged: Any
    """(n,) whether the residual is at most `LARGEST_RESIDUAL`."""


def rest(
    plant: Plant,
    commands: Float[Array, "n S C"],
    previous: Float[Array, "n S C"],
    counts: Discretisation = Discretisation(),
) -> Rest:
    """Where the arm rests with its cables at `commands`, which it reached from the `previous` ones.

    Derivatives by the plant's numbers and by the commands are those of the state of rest. It needs float64: in single
    precision no arm converges.

    Args:
        commands: length of each cable relative to home [m], + pays out.
    """
    plant = jax.tree.map(jnp.asarray, plant)
    modes, slope = _modes_at_rest(counts, plant, commands, previous)
    found = _largest(slope)
    cables = cables_of(plant, commands, previous)
    shapes = shapes_of(plant, modes, counts)
    chain = chain_of(plant, shapes)
    frame = chain.tip_rotation.product(rotation_by(Vector(*plant.tip_rotation)))
    return Rest(
        pose=jnp.stack(jax.tree.leaves((chain.tip, frame.x, frame.y)), axis=1),
        tension=cable_tensions(plant, cables, cable_lengths(plant, shapes)).transpose(2, 1, 0),
        modes=modes.transpose(2, 1, 0),
        residual=found,
        converged=found <= LARGEST_RESIDUAL,
    )


compiled_rest = jit_of_chains(rest, static_argnums=3)
"""`rest`, compiled; all arguments by position. A CPU is fastest with some 64 rows: more no longer fit its caches, and all
rows of a batch wait for the slowest. `robot.batching.in_batches` takes any number."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _modes_at_rest(
    counts: Discretisation, plant: Plant, commands: jax.Array, previous: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Modes, and the slope of the energy by them, both (size, S, n)."""
    cables = cables_of(plant, commands, previous)
    bends = nominal_bends(plant, commands)
    start = jnp.zeros((counts.size, *bends.shape[1::-1]), bends.dtype)
    start = start.at[0].set(bends[..., 0].T).at[counts.bending].set(bends[..., 1].T)
    return _search(plant, cables, start, counts)


@_modes_at_rest.defjvp
def _modes_at_rest_jvp(counts: Discretisation, primals: Any, tangents: Any) -> Any:
    """The residual stays zero: its change by the arguments is made up by the modes."""
    modes, slope = _modes_at_rest(counts, *primals)

    def at_modes(plant: Plant, commands: jax.Array, previous: jax.Array) -> jax.Array:
        return residual(plant, cables_of(plant, commands, previous), modes, counts)

    _, change = jax.jvp(at_modes, primals, tangents)
    plant = primals[0]
    matrix = _matrix(curvature_of(plant, cables_of(*primals), modes, counts))
    return (modes, slope), (_solved(jnp.linalg.cholesky(matrix), -change), jnp.zeros_like(slope))


@dataclasses.dataclass(frozen=True)
class _Problem:
    """What stays the same in a search."""

    plant: Plant
    cables: Cables
    counts: Discretisation


@struct.dataclass
class _Search:
    """A search under way, every row at the lowest place that it has found."""

    modes: jax.Array
    """(size, S, n)."""
    energy: jax.Array
    """(n,) there."""
    residual: jax.Array
    """(size, S, n) there."""
    share: jax.Array
    """(n,) of its step that a row goes next."""
    factor: jax.Array
    """(n, S size, S size) Cholesky factor of the second derivatives, there or at an earlier place."""
    is_stale: jax.Array
    """() whether the next step needs a new factor."""
    tries: jax.Array
    """() number of steps tried."""


def _search(plant: Plant, cables: Cables, start: jax.Array, counts: Discretisation) -> tuple[jax.Array, jax.Array]:
    """Modes and residuals (size, S, n) when all rows rest, or after many tries."""
    problem = _Problem(plant, cables, counts)
    size, num_segments, rows = start.shape
    unknowns = size * num_segments

    def is_unfinished(search: _Search) -> jax.Array:
        return (search.tries < _MOST_TRIES) & ~jnp.all(_largest(search.residual) <= _SOUGHT_RESIDUAL)

    begun = _Search(
        modes=start,
        energy=jnp.full(rows, jnp.inf, start.dtype),
        residual=jnp.full(start.shape, jnp.inf, start.dtype),
        share=jnp.zeros(rows, start.dtype),  # the first try is the start itself
        factor=jnp.broadcast_to(jnp.eye(unknowns, dtype=start.dtype), (rows, unknowns, unknowns)),
        is_stale=jnp.array(False),
        tries=jnp.array(0),
    )
    found = jax.lax.while_loop(is_unfinished, lambda search: _tried(problem, search), begun)
    return found.modes, found.residual


def _tried(problem: _Problem, search: _Search) -> _Search:
    """After one more try. A factor serves as long as each step with it makes every residual ten times smaller."""
    plant, cables, counts = problem.plant, problem.cables, problem.counts
    factor = jax.lax.cond(
        search.is_stale,
        lambda: _factor(problem, curvature_of(plant, cables, search.modes, counts)),
        lambda: search.factor,
    )
    step = _solved(factor, -search.residual)
    bound = jnp.minimum(1.0, _LARGEST_STEP / jnp.maximum(_largest(step), _LARGEST_STEP))
    modes = search.modes + jnp.where(search.share > 0.0, search.share * bound * step, 0.0)
    reached, slope = energy_and_residual(plant, cables, modes, counts)
    is_lower = reached <= search.energy + _ROUNDING * jnp.abs(reached)
    # So near to rest energies differ by less than they are rounded.
    fall = -0.5 * jnp.sum(step * search.residual, axis=(0, 1))
    is_near = (fall <= _NEAR * jnp.max(plant.stiffness.bending)) & (_largest(slope) < _largest(search.residual))
    is_taken = is_lower | is_near
    is_slow = (_largest(slope) > _SOUGHT_RESIDUAL) & ~(_largest(slope) <= _GOOD_SHARE * _largest(search.residual))
    return _Search(
        modes=jnp.where(is_taken, modes, search.modes),
        energy=jnp.where(is_taken, reached, search.energy),
        residual=jnp.where(is_taken, slope, search.residual),
        share=jnp.where(is_taken, 1.0, _SHORTER * search.share),
        factor=factor,
        is_stale=jnp.any(is_slow) | (search.tries == 0),
        tries=search.tries + 1,
    )


def _largest(values: jax.Array) -> jax.Array:
    """(n,) of (size, S, n)."""
    return jnp.max(jnp.abs(values), axis=(0, 1))


def _factor(problem: _Problem, curvature: Curvature) -> jax.Array:
    """Of all second derivatives, or of each segment's own stiffness where the energy is curved the wrong way."""
    lower = jnp.linalg.cholesky(_matrix(curvature))
    is_wrong = jnp.any(jnp.isnan(lower), axis=(1, 2))

    def mended() -> jax.Array:
        return jnp.where(is_wrong[:, None, None], jnp.linalg.cholesky(_stiff_matrix(problem, curvature)), lower)

    return jax.lax.cond(jnp.any(is_wrong), mended, lambda: lower)


def _matrix(curvature: Curvature) -> jax.Array:
    """All second derivatives (n, S size, S size)."""
    size, _, count, rows = curvature.blocks.shape
    pairs = zip(jax.tree.leaves(curvature.lever), jax.tree.leaves(curvature.swing), strict=True)
    coupling = -sum(
        lever.transpose(2, 1, 0)[:, :, :, None, None] * swing.transpose(2, 1, 0)[:, None, None]
        for lever, swing in pairs
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
