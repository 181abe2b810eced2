"""Fit a forward model of a robot to settled rows, and measure it on rows that it never saw."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.geometry.pose import row_errors
from qjrl.learning.fitting import FitResult, fit
from qjrl.robot.forward_model import (
    ForwardModel,
    ForwardModelConfig,
    make_network,
    model_inputs,
    model_pose,
    pose_function,
)
from qjrl.robot.kinds import kind_of
from qjrl.robot.model_uncertainty import calibrate
from qjrl.robot.settled_rows import settled_rows
from qjrl.robot.verbs import Robot, configuration_from_cables

Rows = Mapping[str, np.ndarray]


def fit_forward_model(
    robot: Robot, config: ForwardModelConfig, data: Rows, seed: int, directory: Path
) -> tuple[ForwardModel, dict[str, Any]]:
    """Fit on the settled rows of a data set; goes on where an interrupted fit in `directory` stopped.

    Returns:
        The best model, and its held-out errors beside the nominal closed form's on the same rows.
    """
    train, held_out = settled_split(robot, data, config.held_out, seed)
    model, result = fit_rows(robot, config, (train, held_out), seed, directory)
    metrics = {
        "form": config.form,
        "rows": {
            "fitted": len(train["seed"]),
            "held_out": len(held_out["seed"]),
            "unsettled": int(np.sum(~data["converged"])),
        },
        "best_epoch": result.epoch,
        "held_out": result.metrics,
        "nominal": pose_errors(
            jax.vmap(pose_function(robot, None))(jnp.asarray(held_out["cable_lengths"])), held_out["pose"]
        ),
    }
    if config.ensemble > 1:
        model, metrics["uncertainty"], _ = calibrate(robot, model, held_out)
    return model, metrics


def fit_rows(
    robot: Robot,
    config: ForwardModelConfig,
    split: tuple[Rows, Rows],
    seed: int,
    directory: Path,
    label: str = "fitting",
) -> tuple[ForwardModel, FitResult]:
    """Fit on the first rows of a split, all settled; keep the checkpoint whose median error on the second is least."""
    train, held_out = split
    inputs = jax.jit(jax.vmap(lambda row: model_inputs(robot, config.form, row)))(jnp.asarray(train["cable_lengths"]))
    result = fit(
        config.fit,
        make_network(robot, config),
        (np.asarray(inputs), np.asarray(model_targets(robot, config.form, train))),
        evaluation(robot, config.form, held_out),
        "median_mm",
        directory,
        seed,
        label=label,
        num_members=config.ensemble,
    )
    return ForwardModel(result.fitted, config), result


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


def model_targets(robot: Robot, form: str, data: Rows) -> jax.Array:
    """What the network shall answer for rows of a data set: poses, or corrections of the configuration."""
    if form == "paper":
        return jnp.asarray(data["pose"])
    nominal = jax.vmap(lambda lengths: configuration_from_cables(robot, lengths))(jnp.asarray(data["cable_lengths"]))
    return (jnp.asarray(data[kind_of(robot).configuration_name]) - nominal).reshape(len(nominal), -1)


def evaluation(robot: Robot, form: str, data: Rows) -> Callable[[Any], dict[str, float]]:
    """`evaluate` for the fitting loop: errors of a network's answers on the rows of `data`, in mm and degrees."""
    lengths = jnp.asarray(data["cable_lengths"])
    inputs = jax.jit(jax.vmap(lambda row: model_inputs(robot, form, row)))(lengths)
    to_poses = jax.jit(jax.vmap(lambda row, answer: model_pose(robot, form, row, answer)))
    return lambda answer: pose_errors(to_poses(lengths, answer(inputs).astype(lengths.dtype)), data["pose"])


def pose_errors(poses: Any, truth: Any) -> dict[str, float]:
    """Quantiles of position error [mm] and orientation error [deg] over rows (n, 9)."""
    position, orientation = row_errors(poses, truth)
    millimetres, degrees = 1e3 * position, np.degrees(orientation)
    return {
        "median_mm": float(np.median(millimetres)),
        "p90_mm": float(np.percentile(millimetres, 90)),
        "p99_mm": float(np.percentile(millimetres, 99)),
        "median_deg": float(np.median(degrees)),
        "p90_deg": float(np.percentile(degrees, 90)),
        "p99_deg": float(np.percentile(degrees, 99)),
    }


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
