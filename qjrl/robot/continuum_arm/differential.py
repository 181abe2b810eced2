"""The tip and how it moves with the bends, segment by segment: for descents, whose time it is."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qjrl.robot.continuum_arm.arm import ContinuumArm
from qjrl.robot.continuum_arm.segment import segment_pose
from qjrl.robot.tip import Tip


def tip_of(arm: ContinuumArm, coordinates: Float[Array, "coordinates *batch"]) -> Tip:
    """Tip and Jacobian of bends in a row (2 segments, *batch) [rad]."""
    function = _tip
    for _ in coordinates.shape[1:]:
        function = jax.vmap(function, in_axes=(None, -1), out_axes=-1)
    return function(arm, coordinates)


def _tip(arm: ContinuumArm, row: jax.Array) -> Tip:
    """Each bend moves the end of its segment, and turns all beyond it about that end."""
    lengths = jnp.asarray(arm.segment_lengths, row.dtype)
    position, rotation = jnp.zeros(3, row.dtype), jnp.eye(3, dtype=row.dtype)
    ends: list[tuple[Any, Any, Any]] = []
    for number, bend in enumerate(row.reshape(arm.num_segments, 2)):
        (shift, turn), (velocity, rate) = _moved(lengths[number], bend)
        spin = 0.5 * jnp.sum(jnp.cross(turn[..., None], rate, axis=0), axis=1)  # of each column r: r x dr / 2
        start = rotation
        position, rotation = position + start @ shift, start @ turn
        ends.append((position, start @ velocity, start @ spin))
    columns = [velocity + jnp.cross(spin, (position - end)[:, None], axis=0) for end, velocity, spin in ends]
    spins = [spin for _, _, spin in ends]
    return Tip(position, rotation, jnp.concatenate(columns, axis=1), jnp.concatenate(spins, axis=1))


def _moved(length: jax.Array, bend: jax.Array) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Pose of a segment's end, and its slopes (3, 2) and (3, 3, 2) by the bend."""
    slopes = [
        jax.jvp(lambda one: segment_pose(length, one), (bend,), (direction,))
        for direction in jnp.eye(2, dtype=bend.dtype)
    ]
    return slopes[0][0], jax.tree.map(lambda *columns: jnp.stack(columns, axis=-1), *(slope for _, slope in slopes))
