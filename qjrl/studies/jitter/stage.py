"""Stage `jitter`: joint velocities at rest, C MuJoCo against MJX, of servo strands and of strands that are tendon limits."""

import dataclasses
from pathlib import Path

import numpy as np

from qjrl import progress
from qjrl.report.output import Drawn, Output
from qjrl.robot import robot_from_mapping
from qjrl.stage_config import RobotStageConfig
from qjrl.studies.jitter import figures, report
from qjrl.studies.jitter.cases import JitterConfig, sweeps
from qjrl.studies.jitter.measure import Findings, num_plays, study


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    needs = ("build_mjcf",)

    jitter: JitterConfig


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`, `norms.npz`, `table.md` and the figures; tables and verdict are shown."""
    del inputs, out
    robot, settings = robot_from_mapping(config.robot), config.jitter
    with progress.track(num_plays(settings), "playing") as advance:
        findings = study(robot, settings, config.seed, advance)
    metrics = report.metrics_of(settings, findings)
    return Output(
        metrics,
        {"norms": _norms(settings, findings)},
        lambda: Drawn(
            {
                "norms": figures.velocity_norms(settings, findings),
                "settings": figures.settings_tried(settings, metrics),
                "width": figures.cost_of_width(metrics, settings.force),
            }
        ),
        tables={"table": (report.speed_table(metrics), report.average_table(settings, metrics))},
        shown=(metrics["verdict"],),
    )


def _norms(settings: JitterConfig, findings: Findings) -> dict[str, np.ndarray]:
    """Norm of the joint velocities (poses, steps) [rad/s] of each kind of cables in each engine."""
    return {
        f"{label} / {engine}": motion.norm
        for label, case in sweeps(settings)["cables"].items()
        for engine, motion in findings.motions[case].items()
    }
