"""Stage `workspace`: what the tips of arms reach, how it overlaps, and whether the paper's claim about it holds."""

import dataclasses
from pathlib import Path

from qjrl import artifacts, progress
from qjrl.report.output import Drawn, Output
from qjrl.robot import robot_hash
from qjrl.stage_config import StageConfig
from qjrl.studies.workspace import comparison
from qjrl.studies.workspace.report import workspace_figures, workspace_report
from qjrl.studies.workspace.survey import WorkspaceConfig, measure_workspaces, num_poses, robot_of


@dataclasses.dataclass(frozen=True)
class Config(StageConfig):
    workspace: WorkspaceConfig

    def check(self) -> None:
        """Every arm can be read."""
        for arm in self.workspace.arms:
            robot_of(arm)

    @property
    def robot_hash(self) -> str:
        """Of all arms: a changed description of one of them is a changed stage."""
        return artifacts.hash_of([robot_hash(robot_of(arm)) for arm in self.workspace.arms])


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`, `rings.npz`, figures and `report.html`; the tables are shown."""
    del inputs, out
    settings = config.workspace
    with progress.track(num_poses(settings), "drawing poses") as advance:
        workspaces = measure_workspaces(settings, config.seed, advance)
    pairs = comparison.compare(workspaces, settings.comparable_share)
    verdict = comparison.evaluate(pairs, settings.comparable_share)

    def draw() -> Drawn:
        pictures = workspace_figures(settings, workspaces)
        figures = {name: figure for name, (figure, _) in pictures.items()}
        return Drawn(figures, {"report": workspace_report(settings, workspaces, pairs, pictures)})

    return Output(
        comparison.metrics_of(settings, workspaces, pairs),
        {"rings": {f"{one.config.label}/{law}": hits for one in workspaces for law, hits in one.hits.items()}},
        draw,
        shown=(
            comparison.volume_table(workspaces),
            comparison.voxel_table(workspaces, settings.coarse_factor),
            comparison.arm_table(workspaces, settings.coarse_factor),
            comparison.overlap_table(pairs),
            f"{verdict.headline}. {verdict.detail}",
        ),
    )
