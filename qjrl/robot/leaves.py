"""The numbers of a description as leaves of a pytree, and back: each stands in the pytree alone.

A description says which leaf is which of its fields (`Places`). As described, a number is a plain one, exact in any
precision; a changed leaf changes the description that is made of the leaves again.
"""

import functools
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from qjrl.config import ConfigError

type Number = Any
"""A plain number, an array, a batch of them, or what JAX puts in a tree's place."""

Places = Mapping[str, str]
"""Leaf -> its place in the description, "joint.pin_distance"."""


class Exact(float):
    """A plain number, which keeps its digits without double precision and can be cast as an array can."""

    def astype(self, dtype: Any) -> jax.Array:
        return jnp.asarray(float(self), dtype)


def leaves_of(config: Any, places: Places) -> dict[str, Any]:
    """The leaves of a description: numbers as `Exact`, tuples as arrays, None as it is."""
    return {leaf: _leaf(functools.reduce(getattr, place.split("."), config)) for leaf, place in places.items()}


def described(robot: Any, places: Places, num_axes: Mapping[str, int]) -> dict[str, Any]:
    """The mapping of a description that has a robot's leaves in their places, on the host.

    Args:
        num_axes: of the leaves that are arrays.
    Raises:
        ConfigError: the leaves are those of a batch of robots, or are traced by JAX.
    """
    mapping: dict[str, Any] = {}
    for leaf, place in places.items():
        *section, key = place.split(".")
        inner = mapping.setdefault(section[0], {}) if section else mapping
        inner[key] = _plain(leaf, getattr(robot, leaf), num_axes.get(leaf, 0))
    return mapping


def _leaf(value: Any) -> Any:
    return None if value is None else np.array(value) if isinstance(value, tuple) else Exact(value)


def _plain(leaf: str, value: Any, num_axes: int) -> Any:
    """A leaf as the plain numbers of a description: the shortest that are the same in the leaf's precision."""
    if value is None:
        return None
    if isinstance(value, Tracer):
        raise ConfigError(
            f"robot.{leaf}: got a value that JAX traces, allowed: a number, for the robot to be described"
        )
    array = np.asarray(value)
    if array.ndim != num_axes:
        raise ConfigError(
            f"robot.{leaf}: got an array of shape {array.shape}, allowed: {num_axes} axes; take one robot of a batch"
        )
    numbers = [float(str(number)) for number in array.ravel()]
    return numbers[0] if array.ndim == 0 else np.array(numbers).reshape(array.shape).tolist()
