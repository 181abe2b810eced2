"""Which forward model for how many rows: learning curves, an ablation, accuracy against latency, an ensemble.

All fits see the first so many of the same rows and are evaluated on the same held-out rows, which no fit sees. A fit that
several parts of the study share is made once; a finished one is read again, an interrupted one goes on.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from qjrl.config import Range, as_mapping, configuration, shipped
from qjrl.measured import read_progress
from qjrl.robot.model_coordinates import Rows
from qjrl.robot.model_fitting import errors_of, settled_split
from qjrl.robot.model_uncertainty import calibrate
from qjrl.robot.network_fitting import fit_rows
from qjrl.robot.network_model import NetworkModel, NetworkModelConfig
from qjrl.robot.verbs import Robot
from qjrl.studies.model_study.latency import LatencyConfig, measure_latency

NumRows = Annotated[int, Range(10)]


@configuration
class ModelStudyConfig:
    """Group `model_study`; all fits are of one seed. All values ours."""

    paper: NetworkModelConfig = dataclasses.field(
        default_factory=lambda: shipped(NetworkModelConfig, "forward_model/paper")
    )
    """The paper's network."""
    corrected: NetworkModelConfig = NetworkModelConfig()
    """Ours; the ablation and the widths change one thing of it at a time."""
    sizes: tuple[NumRows, ...] = (1000, 3000, 10_000, 30_000, 100_000)
    """Rows fitted for the learning curves; a size above what is there becomes what is there."""
    held_out: Annotated[float, Range(above=0.0, high=0.5)] = 0.1
    """Share of the settled rows that no fit sees."""
    most_visits: Annotated[int, Range(1)] = 1_200_000
    """Rows times epochs of one fit of the paper's network at most: many rows get fewer epochs, 40 of 30,000
    rows, 13 of 90,000."""
    ablation_rows: NumRows = 10_000
    """Rows fitted for the ablation."""
    frequencies: tuple[Annotated[int, Range(0, 16)], ...] = (0, 1, 2, 6)
    """Numbers of frequencies of the ablation."""
    blocks: tuple[Annotated[int, Range(0, 64)], ...] = (1, 2, 4)
    """Numbers of residual blocks of the ablation."""
    widths: tuple[Annotated[int, Range(1, 8192)], ...] = (64, 128, 256, 512)
    """Widths of the ablation and of the curve of accuracy against latency."""
    width_rows: NumRows = 30_000
    """Rows fitted for the curve of accuracy against latency."""
    ensemble: Annotated[int, Range(2, 64)] = 4
    """Members of the ensemble whose uncertainty is reported."""
    ensemble_rows: NumRows = 30_000
    """Rows that it is fitted to."""
    latency: LatencyConfig = LatencyConfig()
    """How latency is measured."""


@dataclasses.dataclass(frozen=True)
class StudyFit:
    """One fit of the study; two parts that ask for the same one share it."""

    config: NetworkModelConfig
    rows: int

    @property
    def name(self) -> str:
        """Of its directory: what distinguishes the fits of one study."""
        network = self.config.network
        size = f"width{network.width}-blocks{network.num_blocks}-frequencies{network.num_frequencies}"
        return f"{self.config.form}-{size}-members{self.config.ensemble}-rows{self.rows}"

    @property
    def cost(self) -> float:
        """About proportional to the time of the fit."""
        network = self.config.network
        weights = network.width**2 * (2 * network.num_blocks + 1) * self.config.ensemble
        return float(self.rows) * self.config.fit.epochs * weights


Plan = dict[str, dict[str, StudyFit]]
"""Part of the study -> label -> fit."""


def make_plan(config: ModelStudyConfig, available: int) -> Plan:
    """All fits of the study, when `available` rows may be fitted."""
    sizes = sorted({min(size, available) for size in config.sizes})
    ours, rows = config.corrected, min(config.ablation_rows, available)
    ensemble = dataclasses.replace(ours, ensemble=config.ensemble)
    return {
        "paper": {str(size): StudyFit(_shortened(config, size), size) for size in sizes},
        "corrected": {str(size): StudyFit(ours, size) for size in sizes},
        "coordinates": {form: StudyFit(_changed(ours, form), rows)
                        for form in ("paper", "corrected_from_lengths", "corrected")},
        "frequencies": {str(n): StudyFit(_resized(ours, num_frequencies=n), rows) for n in config.frequencies},
        "blocks": {str(n): StudyFit(_resized(ours, num_blocks=n), rows) for n in config.blocks},
        "width": {str(n): StudyFit(_resized(ours, width=n), rows) for n in config.widths},
        "latency": {str(n): StudyFit(_resized(ours, width=n), min(config.width_rows, available))
                    for n in config.widths},
        "ensemble": {str(config.ensemble): StudyFit(ensemble, min(config.ensemble_rows, available))},
    }  # fmt: skip


def run_study(
    robot: Robot, config: ModelStudyConfig, data: Rows, seed: int, directory: Path
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Make all fits, the cheap ones first, and measure them.

    Returns:
        What `metrics.json` holds; and of the ensemble, on the rows its factors were not fitted to, position and
        orientation error and sigma (n,) [m], [rad].
    """
    train, held_out = settled_split(robot, data, config.held_out, seed)
    plan = make_plan(config, len(train["seed"]))
    fits = {fit.name: fit for part in plan.values() for fit in part.values()}
    results, models = {}, {}
    for name, fit in sorted(fits.items(), key=lambda item: item[1].cost):
        models[name], results[name] = run_fit(robot, fit, (train, held_out), seed, directory / name)
    metrics: dict[str, Any] = {"seed": seed, "held_out_rows": len(held_out["seed"])}
    metrics |= {part: {label: results[fit.name] for label, fit in members.items()} for part, members in plan.items()}
    for label, fit in plan["latency"].items():
        metrics["latency"][label] = results[fit.name] | measure_latency(robot, models[fit.name], config.latency)
    best = models[list(plan["corrected"].values())[-1].name]
    metrics["limits"] = errors_by_tension(robot, best, held_out)
    ensemble = next(iter(plan["ensemble"].values()))
    _, metrics["uncertainty"], evaluated = calibrate(robot, models[ensemble.name], held_out)
    return metrics, evaluated


def run_fit(
    robot: Robot, fit: StudyFit, split: tuple[Rows, Rows], seed: int, directory: Path
) -> tuple[NetworkModel, dict[str, Any]]:
    """One fit and its result; the fitting loop reads a finished fit again and goes on with an interrupted one."""
    train = {name: column[: fit.rows] for name, column in split[0].items()}
    model, result = fit_rows(robot, fit.config, (train, split[1]), seed, directory, label=fit.name)
    last = read_progress(directory / "progress.jsonl", "cpu_seconds")[-1]
    sample = {name: column[: len(split[1]["seed"])] for name, column in train.items()}
    return model, {
        "rows": fit.rows,
        "epochs": fit.config.fit.epochs,
        "best_epoch": result.epoch,
        "network": as_mapping(fit.config.network),
        "members": fit.config.ensemble,
        "cpu_seconds": last["cpu_seconds"],
        "held_out": result.metrics,
        "fitted": errors_of(robot, model, sample),
    }


def errors_by_tension(robot: Robot, model: NetworkModel, data: Rows) -> dict[str, Any]:
    """Errors where all strands pull and where one hangs slack: there the physics has a kink."""
    slack = data["strand_tension"].min(axis=1) <= 0.0
    parts = {"all strands taut": ~slack, "some strand slack": slack}
    return {
        label: {"rows": int(rows.sum()), **errors_of(robot, model, {name: col[rows] for name, col in data.items()})}
        for label, rows in parts.items()
        if rows.any()
    }


def _shortened(config: ModelStudyConfig, rows: int) -> NetworkModelConfig:
    epochs = max(1, min(config.paper.fit.epochs, config.most_visits // rows))
    return dataclasses.replace(config.paper, fit=dataclasses.replace(config.paper.fit, epochs=epochs))


def _changed(config: NetworkModelConfig, form: Any) -> NetworkModelConfig:
    return dataclasses.replace(config, form=form)


def _resized(config: NetworkModelConfig, **sizes: int) -> NetworkModelConfig:
    return dataclasses.replace(config, network=dataclasses.replace(config.network, **sizes))
