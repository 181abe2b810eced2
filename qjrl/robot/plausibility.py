"""Whether numbers that enter can be meant: held against what the robot can have, before any work.

A number far beyond what the arm can do is most often one in another unit. Where that would explain it, the error says so.
All doors that take cable lengths, positions or poses from outside ask here; what comes from the package itself is trusted.
What JAX traces has no values yet: its shape and kind are all that is looked at.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from qjrl.config import ConfigError
from qjrl.robot.kind import Robot
from qjrl.robot.kinds import configuration_shape, kind_of, require_robot, verb
from qjrl.robot.unit_hints import length_hint

# Of a path's positions: rolling joints carry the tip a little further than the straight arm's length.
REACH_MARGIN = 1.05
# Of targets, in lengths of the arm: those somewhat out of reach have a nearest answer.
FARTHEST_TARGET = 100.0
# Of commands that are settled, in strokes of the cable: answers beyond the joints' limits may be asked for.
LARGEST_COMMAND = 20.0
# Of a file of cable lengths, in strokes of the cable.
LARGEST_PLANNED = 1.25


def real_numbers(value: Any, where: str) -> Any:
    """The array that `value` is or makes, if it holds real numbers and nothing else.

    Raises:
        ConfigError: texts, truth values, complex numbers, a masked array, rows of unequal length.
    """
    if isinstance(value, np.ma.MaskedArray):
        raise ConfigError(f"{where}: got a masked array, allowed: real numbers; leave the masked rows out")
    try:
        is_traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value))
        array = value if hasattr(value, "dtype") else jnp.asarray(value) if is_traced else np.asarray(value)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where}: got rows of unequal length, allowed: an array of real numbers") from error
    if not (jnp.issubdtype(array.dtype, jnp.floating) or jnp.issubdtype(array.dtype, jnp.integer)):
        raise ConfigError(f"{where}: got {array.dtype.name} values, allowed: real numbers")
    return array.astype(np.float64) if array.dtype.itemsize > 8 else array  # JAX has no wider ones


def one_sample(value: Any, shape: tuple[int, ...], where: str) -> jax.Array:
    """One sample as an array.

    Raises:
        ConfigError: it is not real or not finite, or has another shape: JAX's indexing would take some of it, or repeat
            the last.
    """
    array = jnp.asarray(real_numbers(value, where))
    if jnp.issubdtype(array.dtype, jnp.integer):  # what is computed from it must not be cut to integers
        array = array.astype(float)
    if array.shape != shape:
        raise ConfigError(
            f"{where}: got the shape {array.shape}, allowed: {shape}, one sample; jax.vmap maps over many"
        )
    if not _is_traced(array) and not (is_finite := np.isfinite(np.asarray(array))).all():
        index = np.argwhere(~is_finite)[0]
        raise ConfigError(f"{where}: got {array[tuple(index)]} at {index.tolist()}, allowed: finite numbers")
    return array


def one_configuration(robot: Robot, value: Any) -> jax.Array:
    """One configuration of the robot's kind, such as bends (num_segments, 2).

    Raises:
        ConfigError: see `one_sample`; or what no robot of the kind can have, such as a bend of 180 degrees and more.
    """
    kind = kind_of(robot)
    configuration = one_sample(value, configuration_shape(robot), "configuration")
    if kind.check is not None and not _is_traced(configuration):
        kind.check(robot, np.asarray(configuration)[None], "configuration")
    return configuration


def one_of_lengths(robot: Robot, value: Any) -> jax.Array:
    """One row of cable lengths (num_cables,) [m] that cables can have.

    Raises:
        ConfigError: see `one_sample` and `check_cable_lengths`.
    """
    require_robot(robot)
    lengths = one_sample(value, (robot.num_cables,), "lengths")
    if not _is_traced(lengths, robot):
        check_cable_lengths(robot, np.asarray(lengths)[None], "lengths")
    return lengths


def one_of_positions(robot: Robot, value: Any) -> jax.Array:
    """One row of joint positions (nq,) of the MJCF.

    Raises:
        ConfigError: see `one_sample`.
    """
    require_robot(robot)
    return one_sample(value, (robot.num_positions,), "positions")


def check_angles(angles: Any, where: str) -> None:
    """Refuse bend angles (...,) [rad] that no joint can have.

    Raises:
        ConfigError: not real, or beyond 180 degrees; what is not finite is left as it is.
    """
    if _is_traced(array := real_numbers(angles, where)):
        return
    largest = np.abs(np.asarray(array, np.float64)).max(initial=0.0, where=np.isfinite(array))
    if largest > math.pi:
        hint = "; in degrees? divide by 57.3" if largest <= 180.0 else ""
        raise ConfigError(f"{where}: got {largest:.4g} rad, allowed: up to pi, a bend of 180 degrees{hint}")


def _is_traced(*values: Any) -> bool:
    """Whether JAX knows no numbers of them yet."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def check_cable_lengths(
    robot: Robot, lengths: np.ndarray, where: str = "cable_lengths", strokes: float = LARGEST_COMMAND
) -> None:
    """Refuse cable lengths (n, num_cables) [m], finite, that are many times what the cables can do.

    Args:
        where: what the message begins with.
        strokes: how many strokes of a cable are allowed.
    Raises:
        ConfigError: one line with row and cable.
    """
    with jax.ensure_compile_time_eval():
        allowed = strokes * np.asarray(verb(robot, "cable_strokes")(robot))
    share = np.abs(lengths) / allowed
    if share.size == 0 or share.max() <= 1.0:
        return
    row, cable = np.unravel_index(int(np.argmax(share)), share.shape)
    name = verb(robot, "cable_names")(robot)[int(cable)]
    raise ConfigError(
        f"{where}: row {row} (the first is 0), {name}: got {lengths[row, cable]:.4g} m, allowed: up to "
        f"{allowed[cable]:.3g} m, {strokes:g} times the cable's stroke{length_hint(float(share.max()))}"
    )


def check_positions(
    robot: Robot, positions: np.ndarray, where: str, lengths: float = REACH_MARGIN, noun: str = "row"
) -> None:
    """Refuse positions (n, 3) [m], finite, too many of the straight arm's lengths away from the base.

    Args:
        where: what the message begins with.
        lengths: how many lengths of the arm are allowed.
    Raises:
        ConfigError: one line with the row that is farthest.
    """
    distance, length = np.linalg.norm(positions, axis=1), verb(robot, "reach")(robot)
    if distance.size == 0 or distance.max() <= lengths * length:
        return
    row = int(np.argmax(distance))
    times = "" if lengths == REACH_MARGIN else f"{lengths:g} times "
    raise ConfigError(
        f"{where}: {noun} {row} (the first is 0) is {distance[row]:.4g} m from the base, allowed: up to {times}"
        f"{length:.3g} m, the length of the straight arm{length_hint(float(distance[row]) / (lengths * length))}"
    )
