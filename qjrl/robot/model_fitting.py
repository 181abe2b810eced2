"""Fit a forward model of any kind to settled rows, and measure it on rows that it never saw."""

from pathlib import Path
from typing import Any

import numpy as np

from qjrl.robot.forward_model import pose_function
from qjrl.robot.model_coordinates import Rows
from qjrl.robot.model_errors import pose_errors
from qjrl.robot.model_kind import FittedModel
from qjrl.robot.model_kinds import MODEL_KINDS
from qjrl.robot.pose_model import model_poses
from qjrl.robot.settled_rows import settled_rows
from qjrl.robot.verbs import Robot


def fit_forward_model(robot: Robot, config: Any, data: Rows, seed: int, directory: Path) -> tuple[Any, dict[str, Any]]:
    """Fit on the settled rows of a data set; goes on where an interrupted fit in `directory` stopped, if its kind can.

    Args:
        config: of any of `model_kinds.MODEL_KINDS`.
    Returns:
        The fitted model, and its held-out errors beside the nominal closed form's on the same rows.
    """
    train, held_out = settled_split(robot, data, config.held_out, seed)
    kind = MODEL_KINDS[config.kind]
    model, about = kind.fit(robot, config, (train, held_out), seed, directory)
    left_out = about.pop("rows", {})
    metrics = {
        "kind": config.kind,
        "size": kind.size(model),
        "rows": {
            "fitted": len(train["seed"]),
            "held_out": len(held_out["seed"]),
            "unsettled": int(np.sum(~data["converged"])),
        },
        "nominal": errors_of(robot, None, held_out),
        **about,
    }
    metrics["rows"] |= left_out
    if "held_out" not in metrics:
        metrics["held_out"] = errors_of(robot, model, held_out)
    return model, metrics


def errors_of(robot: Robot, model: FittedModel | None, data: Rows) -> dict[str, float]:
    """Quantiles of the errors of a fitted model on rows, in mm and degrees; None: of the nominal closed form."""
    return pose_errors(model_poses(pose_function(robot, model), data["cable_lengths"]), data["pose"])


def settled_split(
    robot: Robot, data: Rows, held_out: float, seed: int
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The settled rows of a data set, to fit and to hold out.

    Raises:
        ArtifactError: as `settled_rows`.
    """
    settled = settled_rows(robot, data)
    fitted_rows, held_out_rows = split_rows(len(settled["seed"]), held_out, seed)
    return _take(settled, fitted_rows), _take(settled, held_out_rows)


def split_rows(num_rows: int, held_out: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Row numbers to fit and to hold out, a function of the arguments alone.

    Raises:
        ValueError: fewer than two rows.
    """
    if num_rows < 2:
        raise ValueError(f"data set: got {num_rows} settled rows, expected at least 2")
    order = np.random.default_rng(seed).permutation(num_rows)
    num_held_out = max(1, round(held_out * num_rows))
    return np.sort(order[num_held_out:]), np.sort(order[:num_held_out])


def _take(data: Rows, rows: np.ndarray) -> dict[str, np.ndarray]:
    return {name: column[rows] for name, column in data.items()}
