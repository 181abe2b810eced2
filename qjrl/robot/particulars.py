"""What a kind of robot says about one of its robots, beside what can be said of all kinds."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

type Row = tuple[str, str]


@dataclasses.dataclass(frozen=True)
class Particulars:
    """Functions of a robot, on the host. `numbers` is what `describe` knows: what all kinds have, and `own`."""

    summary: Callable[[Any], str]
    """robot -> what it is in a few words, after its name."""
    own: Callable[[Any, np.ndarray], dict[str, Any]]
    """(robot, configurations (n, ...) all over its limits) -> its own numbers by name, plain ones in SI units."""
    rows: Callable[[Mapping[str, Any]], Sequence[Row]]
    """(numbers) -> label and text of each line that a person reads of its own numbers."""
    under_load: Callable[[Any, Mapping[str, np.ndarray]], dict[str, Any]]
    """(robot, columns of settled rows) -> numbers of its own."""
    warnings: Callable[[Any, Mapping[str, Any]], list[str]]
    """(robot, numbers, those under load among them where anything has settled) -> what a builder should know, one line each."""
    extreme: Callable[[Any, jax.Array], jax.Array]
    """(robot, numbers (coordinates,) in [0, 1)) -> configuration; of many, one reaches farthest or widest."""
