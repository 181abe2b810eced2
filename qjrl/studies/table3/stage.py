"""Stage `table3`: the paper's protocol for inverse kinematics, on FABRIK and on least squares."""

import dataclasses
from pathlib import Path

from qjrl import progress
from qjrl.report.output import Drawn, Output
from qjrl.robot import load_robot
from qjrl.stage_config import StageConfig
from qjrl.studies.table3 import figures, protocol
from qjrl.studies.table3.table import metrics_of, solver_table


@dataclasses.dataclass(frozen=True)
class Config(StageConfig):
    table3: protocol.Table3Config


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json` and the figures; the table is shown."""
    del inputs, out
    settings, measured = config.table3, []
    with progress.track(5 * len(settings.cases), "solving") as advance:
        for case in settings.cases:
            measured += protocol.measure_case(settings, case, config.seed, advance)
    curves = protocol.success_curves(settings, config.seed)
    metrics = metrics_of(measured, curves)
    first = settings.cases[0]
    _, angles = protocol.draw_targets(load_robot(first.robot), first, settings.num_targets, config.seed)
    papers = [row["success_percent"] for row in metrics["published"] if row["method"] == "FABRIK"]

    def draw() -> Drawn:
        return Drawn(
            {
                "success": figures.success_figure(curves, papers[0] if papers else None),
                "failures": figures.failures_figure(measured[0]),
                "success_by_bend": figures.success_by_bend_figure(measured[0], angles),
                "methods": figures.trade_figure(metrics),
            }
        )

    return Output(metrics, draw=draw, shown=(solver_table(metrics),))
