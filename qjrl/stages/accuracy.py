"""Stage `accuracy`: every controller on targets that the arm can reach, open loop and with measurements."""

import dataclasses
import logging
from pathlib import Path

import numpy as np

from qjrl import artifacts, progress
from qjrl.analysis.canvas import save_png
from qjrl.analysis.feedback_figures import errors_by_measurements
from qjrl.analysis.outcomes import controller_label
from qjrl.analysis.tables import Column, Table, as_text
from qjrl.control.accuracy import AccuracyConfig, ControllerAccuracy, judge_accuracy
from qjrl.control.feedback import Corrected
from qjrl.control.held_out import reachable_targets
from qjrl.control.inversion import IKConfig
from qjrl.robot import robot_from_mapping, robot_hash
from qjrl.robot.forward_model import load_forward_model, pose_function
from qjrl.simulation.settle_problem import SettleConfig

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config:
    robot: dict
    simulation: SettleConfig
    ik: IKConfig
    accuracy: AccuracyConfig
    seed: int


def run(config: Config, inputs: dict[str, Path], out: Path) -> None:
    """Write `metrics.json`, `errors.npz`, `exact.png` and `noisy.png`; the table goes to the log."""
    robot, settings = robot_from_mapping(config.robot), config.accuracy
    model = pose_function(robot, load_forward_model(inputs["forward_model"] / "model", robot))
    data = artifacts.load(inputs["sample"], robot_hash(robot))
    trained = data["pose"][data["converged"]]
    with progress.track(settings.num_targets, "reaching for targets") as advance:
        targets = reachable_targets(
            robot, config.simulation, trained, settings.num_targets, settings.distance, config.seed, advance
        )
    with progress.track(6 * (settings.measurements + 1) * len(targets), "settling, correcting") as advance:
        found = judge_accuracy(robot, model, config.simulation, config.ik, settings, targets, config.seed, advance)
    artifacts.write_arrays(out / "errors.npz", {"target": targets, **_columns(found)})
    artifacts.write_json(out / "metrics.json", {name: _metrics(one) for name, one in found.items()})
    noise = settings.noise
    titles = {
        "exact": "exact measurements",
        "noisy": f"noise {1e3 * noise.position:.2g} mm, {np.degrees(noise.orientation):.2g}°",
    }
    for kind, title in titles.items():
        errors = {name: getattr(one, kind).position_error for name, one in found.items()}
        save_png(errors_by_measurements(errors, title), out / f"{kind}.png", dpi=110)
        log.info("%s", as_text(_table({name: getattr(one, kind) for name, one in found.items()}, title)))


def _columns(found: dict[str, ControllerAccuracy]) -> dict[str, np.ndarray]:
    return {
        f"{name}/{kind}/{quantity}": getattr(getattr(one, kind), quantity)
        for name, one in found.items()
        for kind in ("exact", "noisy")
        for quantity in ("position_error", "orientation_error", "cable_lengths")
    }


def _metrics(one: ControllerAccuracy) -> dict:
    solved = {"solved_share": float(np.mean(one.solved.converged))}
    return solved | {kind: [_quantiles(getattr(one, kind), row) for row in range(len(one.exact.position_error))]
                     for kind in ("exact", "noisy")}  # fmt: skip


def _quantiles(corrected: Corrected, row: int) -> dict[str, float]:
    """After `row` measurements; what did not settle is counted and left out."""
    position, orientation = 1e3 * corrected.position_error[row], np.degrees(corrected.orientation_error[row])
    quantile = lambda values, share: float(np.nanpercentile(values, share))  # noqa: E731
    return {
        "measurements": row,
        "num_unsettled": int(np.isnan(position).sum()),
        "position_median_mm": quantile(position, 50),
        "position_p90_mm": quantile(position, 90),
        "position_p99_mm": quantile(position, 99),
        "orientation_median_deg": quantile(orientation, 50),
        "orientation_p99_deg": quantile(orientation, 99),
    }


def _table(found: dict[str, Corrected], title: str) -> Table:
    """One row a controller and number of measurements."""
    columns = (
        Column("controller"), Column("measurements", 0), Column("median", 4, "mm"), Column("p90", 4, "mm"),
        Column("p99", 4, "mm"), Column("median", 4, "°"), Column("p99", 4, "°"), Column("unsettled", 0),
    )  # fmt: skip
    names = (
        "position_median_mm",
        "position_p90_mm",
        "position_p99_mm",
        "orientation_median_deg",
        "orientation_p99_deg",
    )
    rows = []
    for name, corrected in found.items():
        for number in range(len(corrected.position_error)):
            values = _quantiles(corrected, number)
            rows.append((controller_label(name), number, *(values[key] for key in names), values["num_unsettled"]))
    return Table(columns, tuple(rows), note=title)
