"""The settled rows of a data set, checked: every stage that reads one takes them from here."""

from collections.abc import Mapping

import numpy as np

from qjrl.artifacts import ArtifactError
from qjrl.robot.kinds import configuration_shape, kind_of
from qjrl.robot.verbs import Robot

# Columns that models are fitted on and evaluated by -> their axes; the configuration comes with the kind of robot.
_NEEDED = {"cable_lengths": 2, "pose": 2, "strand_tension": 2, "converged": 1, "seed": 1}


def settled_rows(robot: Robot, data: Mapping[str, np.ndarray], least: int = 2) -> dict[str, np.ndarray]:
    """The rows of a robot's data set at which it came to rest, all columns.

    Args:
        data: columns (n, ...) as stage `sample` writes them.
        least: rows without which there is nothing to do.
    Raises:
        ArtifactError: one line; columns are missing or have other shapes, fewer than `least` rows rest, or a row that counts
            as settled holds a value that is not finite.
    """
    kind = kind_of(robot)
    needed = dict(_NEEDED)
    if kind.senses_configuration:
        needed[kind.configuration_name] = 1 + len(configuration_shape(robot))
    converged = _checked(data, needed)
    rows = np.flatnonzero(converged)
    if len(rows) < least:
        raise ArtifactError(
            f"sample: {len(rows)} of the {len(converged)} rows of its data set came to rest, allowed: at least {least}; look "
            "at the arm with stages=[describe], then change it or group simulation, or raise sample.num_samples"
        )
    for name in needed:
        values = data[name][rows]
        is_finite = np.isfinite(values).reshape(len(rows), -1).all(axis=1)
        if not is_finite.all():
            row = int(rows[np.argmin(is_finite)])
            raise ArtifactError(
                f"sample: row {row} (the first is 0) of its data set counts as settled and holds a value of {name} that is "
                f"not finite, as {int(np.sum(~is_finite))} rows do in all; run stages=[sample] again in another name"
            )
    return {name: column[rows] for name, column in data.items()}


def _checked(data: Mapping[str, np.ndarray], needed: Mapping[str, int]) -> np.ndarray:
    """`converged` (n,), after all columns have been found to be what they should."""
    missing = [name for name in needed if name not in data]
    if missing:
        raise ArtifactError(f"sample: its data set has no {missing[0]}; run stages=[sample]")
    count = len(data["converged"])
    for name in needed:
        shape, kind = data[name].shape, data[name].dtype
        if len(shape) != needed[name] or shape[0] != count or (name == "pose" and shape[1] != 9):
            raise ArtifactError(f"sample: {name} of its data set has the shape {shape}, beside {count} rows")
        if kind.kind not in "biuf":
            raise ArtifactError(f"sample: {name} of its data set holds {kind} values, allowed: real numbers")
    return data["converged"].astype(bool)
