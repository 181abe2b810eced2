"""Tips of millions of random bends: the laws they are drawn by, and how often each cell of a grid is hit."""

import functools
from collections.abc import Callable, Iterator
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.robot import bends_from_angles
from qjrl.robot.quaternion_arm.arm import QuaternionArm, require_arm
from qjrl.robot.quaternion_arm.sampling import planar_bends
from qjrl.robot.quaternion_arm.tip import tip_pose, tip_position
from qjrl.robot.verbs import Robot

BATCH = 1 << 18
"""Poses drawn at once: small enough for the caches, large enough to hide the cost of a call."""


def spatial_bends(robot: Robot, words: jax.Array) -> jax.Array:
    """Bends (segments, 2) with theta uniform up to the limit and phi uniform, from one random word a segment.

    Source: the law of the paper's test poses (paper 000, section 5.2).
    """
    high, low = _halves(words)
    return bends_from_angles(2.0 * jnp.pi * low, robot.bend_limit * high)


def one_plane_bends(robot: QuaternionArm, words: jax.Array) -> jax.Array:
    """Bends (segments, 2) all in one plane of uniform azimuth, from one random word a segment: they find the boundary."""
    high, low = _halves(words)
    return planar_bends(robot, high, 2.0 * jnp.pi * low[0])


class Grid(Protocol):
    """Numbered places; hashable."""

    @property
    def needs_pose(self) -> bool:
        """Whether a place depends on the tip's pose (9,), or on its position (3,) alone."""
        ...

    @property
    def num_places(self) -> int: ...

    def __call__(self, tip: jax.Array, /) -> jax.Array:
        """The number of the place of a tip [m, -]."""
        ...


LAWS: dict[str, Callable[..., jax.Array]] = {"spatial": spatial_bends, "planar": one_plane_bends}


def draw_tips(robot: Robot, law: str, key: jax.Array, count: int) -> np.ndarray:
    """Tip positions (count, 3) [m], float32."""
    return np.asarray(jax.jit(_tips, static_argnums=(1, 3))(in_float32(robot), law, key, count)).T


def count_hits(
    robot: Robot, law: str, grid: Grid, key: jax.Array, num_samples: int
) -> Iterator[tuple[int, np.ndarray]]:
    """Yields (samples, hits (num_places,)) batch after batch, until `num_samples` are drawn."""
    robot, sizes = in_float32(robot), _batches(num_samples)
    ahead = [_places(robot, law, grid, jax.random.fold_in(key, 0), sizes[0])]
    for index, size in enumerate(sizes):
        if index + 1 < len(sizes):  # the next batch is computed while this one is counted
            ahead.append(_places(robot, law, grid, jax.random.fold_in(key, index + 1), sizes[index + 1]))
        yield size, np.bincount(np.asarray(ahead.pop(0)), minlength=grid.num_places)


def in_float32(robot: Robot) -> Robot:
    """The same robot with its numbers in single precision."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), robot)


@functools.partial(jax.jit, static_argnums=(1, 2, 4))
def _places(robot: Robot, law: str, grid: Grid, key: jax.Array, count: int) -> jax.Array:
    return jax.vmap(grid, in_axes=-1)(_tips(require_arm(robot, "workspace"), law, key, count, grid.needs_pose))


def _tips(robot: QuaternionArm, law: str, key: jax.Array, count: int, needs_pose: bool = False) -> jax.Array:
    """(3, count) or (9, count), the samples last, so that every number of a pose is one contiguous array."""
    words = jax.random.bits(key, (robot.num_segments, count), jnp.uint32)
    bends = jax.vmap(lambda row: LAWS[law](robot, row), in_axes=-1, out_axes=-1)(words)
    bends = jax.lax.optimization_barrier(bends)  # else sines and cosines are computed again for every coordinate
    tip = tip_pose if needs_pose else tip_position
    return jax.vmap(lambda row: tip(robot, row), in_axes=-1, out_axes=-1)(bends)


def _halves(words: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Two numbers in (0, 1) from the halves of each random word: 16 bits are 0.006 degrees of a turn."""
    return tuple(((half & 0xFFFF).astype(jnp.float32) + 0.5) / 65536.0 for half in (words >> 16, words))  # pyright: ignore[reportReturnType]


def _batches(num_samples: int) -> list[int]:
    full, rest = divmod(num_samples, BATCH)
    return [BATCH] * full + [rest] * (rest > 0)
