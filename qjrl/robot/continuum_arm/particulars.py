"""What `describe` says of this arm alone."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from qjrl.robot.continuum_arm.arm import ContinuumArm
from qjrl.robot.continuum_arm.sampling import planar_bends
from qjrl.robot.particulars import Particulars, Row


def summary(arm: ContinuumArm) -> str:
    """Segments and cables."""
    return f"{arm.num_segments} segments of a flexible backbone, {arm.cables_per_segment} cables each"


def own(arm: ContinuumArm, bends: np.ndarray) -> dict[str, Any]:
    """Counts, lengths [m] and the bend limit."""
    del bends
    return {
        "segments": arm.num_segments,
        "cables_per_segment": arm.cables_per_segment,
        "segment_lengths": np.asarray(arm.segment_lengths).tolist(),
        "anchor_radii": np.asarray(arm.anchor_radii).tolist(),
        "bend_limit_deg": float(arm.bend_limit_deg),
    }


def rows(numbers: Mapping[str, Any]) -> list[Row]:
    """Segments and how far they bend."""
    lengths, radii = ([f"{1e3 * value:g}" for value in numbers[key]] for key in ("segment_lengths", "anchor_radii"))
    return [
        ("segments", f"{', '.join(lengths)} mm long, anchors on circles of {', '.join(radii)} mm"),
        ("bends", f"up to {numbers['bend_limit_deg']:.0f}° a segment"),
    ]


def under_load(arm: ContinuumArm, settled: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Share of the cables that carry nothing."""
    del arm
    return {"slack_share": float(np.mean(settled["strand_tension"] < 0.01))}


def warnings(arm: ContinuumArm, numbers: Mapping[str, Any]) -> list[str]:
    """Where the discs of a segment's anchors would touch."""
    limit = np.radians(float(arm.bend_limit_deg))
    lines = []
    for number, (length, radius) in enumerate(
        zip(numbers["segment_lengths"], numbers["anchor_radii"], strict=True), start=1
    ):
        if radius * limit >= length:
            lines.append(
                f"segment {number}: its discs touch at {np.degrees(length / radius):.0f} deg, below the bend limit"
            )
    return lines


PARTICULARS = Particulars(summary, own, rows, under_load, warnings, planar_bends)
