"""Stage `elliptical_deviation`: how far the joint's path leaves the circle, and what that does to the arm."""

import dataclasses
import logging
from pathlib import Path

from qjrl import artifacts, progress
from qjrl.report.canvas import save_png
from qjrl.report.tables import as_text
from qjrl.robot import robot_from_mapping
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.studies.elliptical_deviation import figures
from qjrl.studies.elliptical_deviation import measure as study

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config:
    robot: dict
    simulation: SettleConfig
    elliptical_deviation: study.DeviationConfig
    seed: int


def run(config: Config, inputs: dict[str, Path], out: Path) -> None:
    """Write `metrics.json` and the figures; tables and verdict go to the log."""
    del inputs
    robot, settings = robot_from_mapping(config.robot), config.elliptical_deviation
    with progress.track(1 + len(settings.variants), "studying joints") as advance:
        studies = study.study_joints(robot, config.simulation, settings, config.seed, advance)
    found = study.joint_map(robot, settings)
    artifacts.write_json(out / "metrics.json", study.metrics_of(robot, settings, studies, found))
    save_png(figures.paths(studies), out / "paths.png", dpi=110)
    save_png(figures.deviations(studies, settings), out / "deviation.png", dpi=110)
    save_png(figures.maps(found, studies, settings), out / "maps.png", dpi=110)
    save_png(figures.tip_shifts(studies, settings), out / "tip_shift.png", dpi=110)
    save_png(figures.tensions(studies), out / "tensions.png", dpi=110)
    for table in (
        study.joint_table(studies, settings),
        study.arm_table(studies, settings),
        study.settled_table(studies),
    ):
        log.info("%s\n", as_text(table))
    log.info("%s", study.verdict(robot, settings, studies, found))
