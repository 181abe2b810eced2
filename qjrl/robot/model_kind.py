"""What a kind of forward model is: a record of how one is configured, fitted, called, saved and loaded."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import jax
import numpy as np

from qjrl.robot.kind import Robot
from qjrl.robot.model_coordinates import Rows
from qjrl.robot.pose_model import PoseFunction


@runtime_checkable
class FittedModel(Protocol):
    """A fitted model of one robot, which it does not hold; a pytree whose leaves are its numbers."""

    @property
    def config(self) -> Any:
        """Of the fit; its `kind` names the record."""


def num_numbers(tree: Any) -> int:
    """How many numbers a pytree holds."""
    return sum(np.size(leaf) for leaf in jax.tree.leaves(tree))


@dataclasses.dataclass(frozen=True)
class ModelKind:
    """One kind of forward model."""

    config: type
    """What the group `forward_model` may hold, a class made by `configuration`. It has `kind`, a Literal of the kind's name
    with that name as default, and `held_out`, the share of the rows that the fit never sees."""
    fit: Callable[[Robot, Any, tuple[Rows, Rows], int, Path], tuple[Any, dict[str, Any]]]
    """(robot, config, rows to fit and rows held out, all settled, seed, directory) -> fitted model, and what
    `metrics.json` says of it; under `rows` what is otherwise of its rows, as where not all were fitted. What it writes to the
    directory is its own; an interrupted fit may go on from it."""
    on_robot: Callable[[Robot, Any], PoseFunction]
    """(robot, fitted model) -> the pytree that is called with lengths and answers a pose in their precision; robot and fitted
    numbers are its leaves, and what is static in it says no more than the structure: models that agree in it share programs."""
    to_arrays: Callable[[Any], Mapping[str, Any]]
    """Fitted model -> its numbers by name, in nested mappings of arrays: what the .npz holds."""
    from_arrays: Callable[[Any, Mapping[str, Any]], Any]
    """(config, such mappings) -> fitted model."""
    names: tuple[str, ...]
    """At the top of those mappings that must be there."""
    size: Callable[[Any], int] = num_numbers
    """Fitted model -> how many numbers were fitted or are kept."""
    robots: tuple[str, ...] | None = None
    """Kinds of robots that it can be fitted to; None: all."""
    has_log: bool = False
    """Whether the fit writes `progress.jsonl`, one record an epoch, and says its `form` and `best_epoch`."""
