"""Workspaces side by side: numbers for `metrics.json`, tables, and whether the paper's claim holds."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from qjrl.report.tables import Column, Table
from qjrl.robot.kinds import verb
from qjrl.studies.workspace.dexterity import mean_over_volume
from qjrl.studies.workspace.occupancy import Overlap, overlap
from qjrl.studies.workspace.survey import ArmWorkspace, WorkspaceConfig

LITRE = 1e-3
"""[m^3]."""


@dataclasses.dataclass(frozen=True)
class Pair:
    """An arm beside a reference."""

    arm: ArmWorkspace
    reference: ArmWorkspace
    overlap: Overlap
    volume_ratio: float
    """Arm over reference."""
    is_comparable: bool
    """Reaches at least `comparable_share` of the reference's volume."""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Whether the claim "comparable workspace" holds."""

    holds: bool | None
    """In every sense (True), in none (False), or in some (None)."""
    headline: str
    detail: str


def compare(workspaces: Sequence[ArmWorkspace], comparable_share: float) -> list[Pair]:
    """Every arm that is no reference beside every reference."""
    pairs = []
    for reference in (one for one in workspaces if one.config.is_reference):
        for arm in (one for one in workspaces if not one.config.is_reference):
            shared = overlap(arm.is_reached, reference.is_reached, arm.rings.volumes)
            ratio = arm.volume.estimate / reference.volume.estimate
            pairs.append(Pair(arm, reference, shared, ratio, shared.of_second >= comparable_share))
    return pairs


def evaluate(pairs: Sequence[Pair], comparable_share: float) -> Verdict:
    """The paper's claim, about its arm at the largest bend limit, against every reference."""
    widest = max(pair.arm.config.bend_limit_deg for pair in pairs)
    evaluated = [pair for pair in pairs if pair.arm.config.bend_limit_deg == widest]
    yes, no = (
        [pair.reference.config.label for pair in evaluated if pair.is_comparable is wanted] for wanted in (True, False)
    )
    subject = evaluated[0].arm.config.label
    senses = [f"comparable with {' and '.join(yes)}"] * bool(yes) + [f"NOT comparable with {' or '.join(no)}"] * bool(
        no
    )
    shares = "; ".join(
        f"{pair.arm.config.label} of {pair.reference.config.label}: {100 * pair.overlap.of_second:.1f} %"
        for pair in pairs
    )
    detail = (
        f"Share of the other's workspace that is reached (comparable from {100 * comparable_share:.0f} % on): {shares}."
    )
    return Verdict(True if not no else None if yes else False, f"Workspace of {subject}: {', '.join(senses)}", detail)


def parts_of(workspace: ArmWorkspace) -> dict[str, int]:
    """What an arm is built of; a passage is one strand crossing one joint."""
    robot = workspace.robot
    crossed = np.cumsum(robot.joints_per_segment)
    return {
        "segments": robot.num_segments,
        "joints": robot.num_joints,
        "motors": robot.num_cables,
        "strands": robot.num_strands,
        "strand_passages": int(4 * crossed.sum()),
    }


def dexterity_of(workspace: ArmWorkspace, factor: int) -> dict[str, float]:
    """Mean shares over the reached volume, after all samples and after half of them, and the best cell's."""
    coarse = workspace.rings.coarser(factor)
    reached = workspace.rings.merged(workspace.is_reached, factor) > 0
    values = {}
    for suffix, shares in (("", workspace.dexterity), ("_half_of_the_samples", workspace.half_dexterity)):
        values[f"directions_mean{suffix}"] = mean_over_volume(shares.directions, coarse.volumes, reached)
        values[f"orientations_mean{suffix}"] = mean_over_volume(shares.orientations, coarse.volumes, reached)
    values["directions_best"] = float(np.nanmax(workspace.dexterity.directions))
    values["orientations_best"] = float(np.nanmax(workspace.dexterity.orientations))
    return values


def extent_of(workspace: ArmWorkspace) -> dict[str, float]:
    """Outer edges of the rings reached [m]."""
    rows, columns = np.nonzero(workspace.is_reached)
    rings = workspace.rings
    return {
        "radius": float((columns.max() + 1) * rings.cell),
        "lowest": float((rows.min() - rings.num_cells) * rings.cell),
        "highest": float((rows.max() + 1 - rings.num_cells) * rings.cell),
    }


def metrics_of(config: WorkspaceConfig, workspaces: Sequence[ArmWorkspace], pairs: Sequence[Pair]) -> dict[str, Any]:
    """Everything measured, SI units, for `metrics.json`."""
    return {
        "verdict": dataclasses.asdict(evaluate(pairs, config.comparable_share)),
        "arms": {one.config.label: _arm_metrics(config, one) for one in workspaces},
        "pairs": [
            {"arm": pair.arm.config.label, "reference": pair.reference.config.label, "volume_ratio": pair.volume_ratio,
             "volume_ratio_interval": _ratio_interval(pair), "is_comparable": pair.is_comparable,
             **dataclasses.asdict(pair.overlap)}
            for pair in pairs
        ],
    }  # fmt: skip


def volume_table(workspaces: Sequence[ArmWorkspace]) -> Table:
    """Volumes in litres: by revolution with its interval, by the plain law alone, and extrapolated; poses a second."""
    columns = (
        Column("arm"), Column("samples", 0), Column("seen", 1, "l"), Column("estimate", 1, "l"),
        Column("low", 1, "l"), Column("high", 1, "l"), Column("spatial alone", 1, "l"), Column("vanishing cells", 1, "l"),
        Column("poses/s", 0),
    )  # fmt: skip
    rows = tuple(
        (
            one.config.label, sum(int(hits.sum()) for hits in one.hits.values()),
            *(value / LITRE for value in (one.volume.seen, one.volume.estimate, one.volume.low, one.volume.high,
                                          one.rings.volume(one.hits["spatial"] > 0), one.limit_volume)),
            one.poses_per_second,
        )
        for one in workspaces
    )  # fmt: skip
    return Table(columns, rows, note=f"volume of revolution of rings {1e3 * workspaces[0].rings.cell:g} mm wide")


def voxel_table(workspaces: Sequence[ArmWorkspace], factor: int) -> Table:
    """The check of the revolution against voxels, in litres and counts."""
    columns = (
        Column("arm"), Column("voxels wholly inside", 1, "l"), Column("voxels hit", 1, "l"), Column("voxels touched", 1, "l"),
        Column("inside, never hit", 0), Column("hit, outside", 0),
    )  # fmt: skip
    rows = tuple(
        (one.config.label, one.voxels.inside / LITRE, one.voxels.hit / LITRE, one.voxels.touched / LITRE,
         one.voxels.missed_inside, one.voxels.hit_outside)
        for one in workspaces
    )  # fmt: skip
    width = 1e3 * workspaces[0].rings.cell * factor
    return Table(columns, rows, note=f"voxels of {width:g} mm; inside and touched: of the revolution of the rings")


def overlap_table(pairs: Sequence[Pair]) -> Table:
    """Both directions of every overlap; marked where the arm is comparable with the reference."""
    columns = (
        Column("arm"), Column("reference"), Column("volume ratio", 3), Column("of the reference reached", 1, "%"),
        Column("of the arm's also reached", 1, "%"), Column("intersection over union", 1, "%"),
    )  # fmt: skip
    rows = tuple(
        (pair.arm.config.label, pair.reference.config.label, pair.volume_ratio, 100 * pair.overlap.of_second,
         100 * pair.overlap.of_first, 100 * pair.overlap.jaccard)
        for pair in pairs
    )  # fmt: skip
    marked = frozenset(row for row, pair in enumerate(pairs) if pair.is_comparable)
    return Table(columns, rows, marked, note="* comparable: reaches enough of the reference")


def arm_table(workspaces: Sequence[ArmWorkspace], factor: int) -> Table:
    """Parts, extent and dexterity."""
    columns = (
        Column("arm"), *(Column(name, 0) for name in ("joints", "motors", "strands", "passages")),
        *(Column(name, 0, "mm") for name in ("length", "radius", "lowest", "highest")),
        Column("directions", 1, "%"), Column("orientations", 1, "%"), Column("best cell", 1, "%"),
    )  # fmt: skip
    rows = []
    for one in workspaces:
        parts, extent, shares = parts_of(one), extent_of(one), dexterity_of(one, factor)
        rows.append(
            (one.config.label, parts["joints"], parts["motors"], parts["strands"], parts["strand_passages"],
             1e3 * home_length(one), *(1e3 * extent[name] for name in ("radius", "lowest", "highest")),
             100 * shares["directions_mean"], 100 * shares["orientations_mean"], 100 * shares["orientations_best"])
        )  # fmt: skip
    note = "directions, orientations: mean share of the bins reached, over the volume reached; a passage is a strand through a joint"
    return Table(columns, tuple(rows), note=note)


def home_length(workspace: ArmWorkspace) -> float:
    """From the base to the tip of the straight arm [m]."""
    return verb(workspace.robot, "reach")(workspace.robot)


def _arm_metrics(config: WorkspaceConfig, one: ArmWorkspace) -> dict[str, Any]:
    return {
        "robot": one.config.robot,
        "bend_limit_deg": one.config.bend_limit_deg,
        "length": home_length(one),
        **parts_of(one),
        **extent_of(one),
        "samples": {law: int(hits.sum()) for law, hits in one.hits.items()},
        "volume": dataclasses.asdict(one.volume),
        "volume_seen_by_law": {law: one.rings.volume(hits > 0) for law, hits in one.hits.items()},
        "volume_vanishing_cells": one.limit_volume,
        "voxels": dataclasses.asdict(one.voxels),
        "convergence": one.convergence,
        "dexterity": dexterity_of(one, config.coarse_factor),
        "poses_per_second": one.poses_per_second,
    }


def _ratio_interval(pair: Pair) -> list[float]:
    """Ends of the ratio's interval from those of both volumes: wider than needed."""
    arm, reference = pair.arm.volume, pair.reference.volume
    return [arm.low / reference.high, arm.high / reference.low]
