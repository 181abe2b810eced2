"""The page of the workspace experiment, and its figures by name."""

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from qjrl.report.html import Number, anchor
from qjrl.report.page import Picture, Report, Section
from qjrl.report.palette import SERIES
from qjrl.studies.workspace import comparison, figures
from qjrl.studies.workspace.cloud_viewer import Cloud, cloud_viewer
from qjrl.studies.workspace.survey import ArmWorkspace, WorkspaceConfig

_IN_VIEWER = 8000
"""Points of an arm in the viewer: turns smoothly on a phone."""


def workspace_figures(config: WorkspaceConfig, workspaces: Sequence[ArmWorkspace]) -> dict[str, tuple[Figure, str]]:
    """File name -> figure and caption."""
    rings = workspaces[0].rings
    labels = {one.config.label: one for one in workspaces}
    pictures = {
        "sections": (
            figures.sections({label: one.is_reached for label, one in labels.items()}, rings),
            "What each arm reaches in the half plane through its base axis; the arms are symmetric about it.",
        )
    }
    for reference in (one for one in workspaces if one.config.is_reference):
        rows = [
            {reference.config.label: (reference.tips, "orange"), one.config.label: (one.tips, "blue")}
            for one in workspaces
            if not one.config.is_reference
        ]
        caption = (
            f"Tips of random bends in three projections (Fig. 7 of the paper), over those of {reference.config.label}."
        )
        pictures[f"clouds-{anchor(reference.config.label)}"] = (figures.clouds(rows), caption)
    pictures["convergence"] = (
        figures.convergence(
            {label: one.convergence for label, one in labels.items()},
            {label: one.volume.estimate for label, one in labels.items()},
        ),
        "Planar bends fill the workspace long before bends in all directions do: the boundary lies on planar poses.",
    )
    pictures["dexterity"] = (
        figures.dexterity_maps(
            {label: one.dexterity.orientations for label, one in labels.items()}, rings.coarser(config.coarse_factor)
        ),
        f"Share of {config.bins.num_bins} equal bins of orientation that the tip takes in each cell.",
    )
    return pictures


def workspace_report(
    config: WorkspaceConfig,
    workspaces: Sequence[ArmWorkspace],
    pairs: Sequence[comparison.Pair],
    pictures: Mapping[str, tuple[Figure, str]],
) -> Report:
    """The whole page."""
    verdict = comparison.evaluate(pairs, config.comparable_share)
    viewer = Picture(_viewer(workspaces), _VIEWER_CAPTION, is_wide=True)
    drawn = [
        Picture(figure, caption, name.startswith(("clouds", "dexterity")))
        for name, (figure, caption) in pictures.items()
    ]
    tables = (
        comparison.overlap_table(pairs),
        comparison.volume_table(workspaces),
        comparison.voxel_table(workspaces, config.coarse_factor),
        comparison.arm_table(workspaces, config.coarse_factor),
    )
    return Report(
        title="Workspaces of the paper's arm and of Huang's",
        headline=verdict.headline,
        detail=verdict.detail,
        holds=verdict.holds,
        summary=tuple(
            Number(one.config.label, 1e3 * one.volume.estimate, "l", f"{comparison.parts_of(one)['joints']} joints")
            for one in workspaces
        ),
        sections=(
            Section("Turn it", pictures=(viewer,)),
            Section("Numbers", _TEXT, tables=tables),
            Section("Pictures", pictures=tuple(drawn)),
        ),
    )


def _viewer(workspaces: Sequence[ArmWorkspace]):
    return cloud_viewer(
        [
            Cloud(one.config.label, one.tips[:_IN_VIEWER], SERIES[index % len(SERIES)])
            for index, one in enumerate(workspaces)
        ]
    )


_VIEWER_CAPTION = "Tips of random bends. Drag or use the arrow keys to turn, + and - or ctrl and the wheel to zoom."
_TEXT = (
    "Volumes are those of the revolution of the rings (square cells in ρ and z) that a tip hits. The estimate adds what is "
    "expected to be unseen, from the rings hit once and twice; low and high are its bootstrap interval. Rings that the "
    "boundary cuts count as full: the column for vanishing cells extrapolates that away. Ratios hardly depend on it."
)
