"""Stage `workspace`: what the tips of arms reach, how it overlaps, and whether the paper's claim about it holds."""

import dataclasses
import logging
from pathlib import Path

from qjrl import artifacts, progress
from qjrl.provenance import read_provenance
from qjrl.report.canvas import save_png
from qjrl.report.page import write_report
from qjrl.report.tables import as_text
from qjrl.robot import robot_hash
from qjrl.studies.workspace import comparison
from qjrl.studies.workspace.report import workspace_figures, workspace_report
from qjrl.studies.workspace.survey import WorkspaceConfig, measure_workspaces, num_poses, robot_of

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config:
    workspace: WorkspaceConfig
    seed: int

    @property
    def robot_hash(self) -> str:
        """Of all arms: a changed description of one of them is a changed stage."""
        return artifacts.hash_of([robot_hash(robot_of(arm)) for arm in self.workspace.arms])


def run(config: Config, inputs: dict[str, Path], out: Path) -> None:
    """Write `metrics.json`, `rings.npz`, figures and `report.html`; the tables go to the log."""
    del inputs
    settings = config.workspace
    with progress.track(num_poses(settings), "drawing poses") as advance:
        workspaces = measure_workspaces(settings, config.seed, advance)
    pairs = comparison.compare(workspaces, settings.comparable_share)
    artifacts.write_json(out / "metrics.json", comparison.metrics_of(settings, workspaces, pairs))
    artifacts.write_arrays(
        out / "rings.npz",
        {f"{one.config.label}/{law}": hits for one in workspaces for law, hits in one.hits.items()},
    )
    pictures = workspace_figures(settings, workspaces)
    for name, (figure, _) in pictures.items():
        save_png(figure, out / f"{name}.png", dpi=110)
    provenance = read_provenance(out)
    write_report(out / "report.html", workspace_report(settings, workspaces, pairs, pictures, provenance))
    for table in (
        comparison.volume_table(workspaces),
        comparison.voxel_table(workspaces, settings.coarse_factor),
        comparison.arm_table(workspaces, settings.coarse_factor),
        comparison.overlap_table(pairs),
    ):
        log.info("%s\n", as_text(table))
    verdict = comparison.evaluate(pairs, settings.comparable_share)
    log.info("%s. %s", verdict.headline, verdict.detail)
