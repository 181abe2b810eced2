"""Stage `table3`: the paper's protocol for inverse kinematics, on FABRIK and on least squares."""

import dataclasses
import logging
from pathlib import Path

from qjrl import artifacts, progress
from qjrl.report.canvas import save_png
from qjrl.report.tables import as_text
from qjrl.robot import load_robot
from qjrl.studies.table3 import figures, protocol
from qjrl.studies.table3.table import metrics_of, solver_table

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config:
    table3: protocol.Table3Config
    seed: int


def run(config: Config, inputs: dict[str, Path], out: Path) -> None:
    """Write `metrics.json` and the figures; the table goes to the log."""
    del inputs
    settings, measured = config.table3, []
    with progress.track(5 * len(settings.cases), "solving") as advance:
        for case in settings.cases:
            measured += protocol.measure_case(settings, case, config.seed, advance)
    curves = protocol.success_curves(settings, config.seed)
    metrics = metrics_of(measured, curves)
    artifacts.write_json(out / "metrics.json", metrics)
    first = settings.cases[0]
    _, angles = protocol.draw_targets(load_robot(first.robot), first, settings.num_targets, config.seed)
    papers = [row["success_percent"] for row in metrics["published"] if row["method"] == "FABRIK"]
    save_png(figures.success_figure(curves, papers[0] if papers else None), out / "success.png", dpi=110)
    save_png(figures.failures_figure(measured[0]), out / "failures.png", dpi=110)
    save_png(figures.success_by_bend_figure(measured[0], angles), out / "success_by_bend.png", dpi=110)
    save_png(figures.trade_figure(metrics), out / "methods.png", dpi=110)
    log.info("%s", as_text(solver_table(metrics)))
