"""Fit the network of a forward model by gradient descent, and the record of its kind."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.learning.fitting import FitResult, fit
from qjrl.robot import network_model
from qjrl.robot.model_coordinates import Rows, model_inputs, model_pose, model_targets
from qjrl.robot.model_errors import pose_errors
from qjrl.robot.model_kind import ModelKind
from qjrl.robot.model_uncertainty import calibrate
from qjrl.robot.network_model import NetworkModel, NetworkModelConfig, make_network
from qjrl.robot.verbs import Robot


def fit_network(
    robot: Robot, config: NetworkModelConfig, split: tuple[Rows, Rows], seed: int, directory: Path
) -> tuple[NetworkModel, dict[str, Any]]:
    """`fit_rows`, and for an ensemble how sure it is; with what `metrics.json` says of both."""
    model, result = fit_rows(robot, config, split, seed, directory)
    metrics: dict[str, Any] = {"form": config.form, "best_epoch": result.epoch, "held_out": result.metrics}
    if config.ensemble > 1:
        model, metrics["uncertainty"], _ = calibrate(robot, model, split[1])
    return model, metrics


def fit_rows(
    robot: Robot,
    config: NetworkModelConfig,
    split: tuple[Rows, Rows],
    seed: int,
    directory: Path,
    label: str = "fitting",
) -> tuple[NetworkModel, FitResult]:
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
    return NetworkModel(result.fitted, config), result


def evaluation(robot: Robot, form: str, data: Rows) -> Callable[[Any], dict[str, float]]:
    """`evaluate` for the fitting loop: errors of a network's answers on the rows of `data`, in mm and degrees."""
    lengths = jnp.asarray(data["cable_lengths"])
    inputs = jax.jit(jax.vmap(lambda row: model_inputs(robot, form, row)))(lengths)
    to_poses = jax.jit(jax.vmap(lambda row, answer: model_pose(robot, form, row, answer)))
    return lambda answer: pose_errors(to_poses(lengths, answer(inputs).astype(lengths.dtype)), data["pose"])


NETWORK = ModelKind(
    config=NetworkModelConfig,
    fit=fit_network,
    on_robot=network_model.on_robot,
    to_arrays=network_model.to_arrays,
    from_arrays=network_model.from_arrays,
    names=network_model.NAMES,
    size=network_model.num_parameters,
    has_log=True,
)
