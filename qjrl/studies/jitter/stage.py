"""Stage `jitter`: joint velocities at rest, C MuJoCo against MJX, of servo strands and of strands that are tendon limits."""

import dataclasses
import logging
from pathlib import Path

import numpy as np

from qjrl import artifacts, progress
from qjrl.report.canvas import save_png
from qjrl.report.tables import as_markdown, as_text
from qjrl.robot import robot_from_mapping
from qjrl.studies.jitter import figures, report
from qjrl.studies.jitter.cases import JitterConfig, sweeps
from qjrl.studies.jitter.measure import Findings, num_plays, study

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config:
    robot: dict
    jitter: JitterConfig
    seed: int


def run(config: Config, inputs: dict[str, Path], out: Path) -> None:
    """Write `metrics.json`, `norms.npz`, `table.md` and the figures; tables and verdict go to the log."""
    del inputs
    robot, settings = robot_from_mapping(config.robot), config.jitter
    with progress.track(num_plays(settings), "playing") as advance:
        findings = study(robot, settings, config.seed, advance)
    metrics = report.metrics_of(settings, findings)
    artifacts.write_json(out / "metrics.json", metrics)
    artifacts.write_arrays(out / "norms.npz", _norms(settings, findings))
    save_png(figures.velocity_norms(settings, findings), out / "norms.png", dpi=110)
    save_png(figures.settings_tried(settings, metrics), out / "settings.png", dpi=110)
    save_png(figures.cost_of_width(metrics, settings.force), out / "width.png", dpi=110)
    tables = (report.speed_table(metrics), report.average_table(settings, metrics))
    artifacts.write_bytes(out / "table.md", "\n".join(map(as_markdown, tables)).encode())
    for table in tables:
        log.info("%s\n", as_text(table))
    log.info("%s", metrics["verdict"])


def _norms(settings: JitterConfig, findings: Findings) -> dict[str, np.ndarray]:
    """Norm of the joint velocities (poses, steps) [rad/s] of each kind of cables in each engine."""
    return {
        f"{label} / {engine}": motion.norm
        for label, case in sweeps(settings)["cables"].items()
        for engine, motion in findings.motions[case].items()
    }
