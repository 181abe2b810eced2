"""Clouds of points that a reader turns in the report: a canvas, a few hundred lines of script, the points in base64."""

import base64
import dataclasses
import json
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from qjrl.report.page import Fragment
from qjrl.report.palette import LIGHT

_FULL = 32_000
"""The largest coordinate as a 16-bit integer."""


@dataclasses.dataclass(frozen=True)
class Cloud:
    """Points of one colour."""

    label: str
    points: np.ndarray
    """(n, 3) [m]."""
    colour: str
    """Name in the palette."""

    def __post_init__(self):
        if self.colour not in LIGHT:
            raise ValueError(f"colour: got {self.colour!r}, allowed: {', '.join(LIGHT)}")


def cloud_viewer(clouds: Sequence[Cloud], axis: float = 0.1) -> Fragment:
    """HTML of a viewer with a box to tick for each cloud; it needs nothing from elsewhere.

    Args:
        axis: length of the drawn axes [m].
    """
    unit = max(float(np.abs(cloud.points).max()) for cloud in clouds) / _FULL
    heights = np.concatenate([cloud.points[:, 2] for cloud in clouds])
    middle = float(heights.min() + heights.max()) / 2.0
    centred = [cloud.points - [0.0, 0.0, middle] for cloud in clouds]
    data = {
        "extent": max(float(np.linalg.norm(points, axis=1).max()) for points in centred) / unit,
        "middle": middle / unit,
        "axis": axis / unit,
        "clouds": [{"colour": cloud.colour, "points": _encoded(cloud.points / unit)} for cloud in clouds],
    }
    boxes = "".join(
        f'<label><input type="checkbox" checked><span style="color: var(--{cloud.colour})">●</span> {escape(cloud.label)}</label>'
        for cloud in clouds
    )
    script = Path(__file__).with_name("cloud_viewer.js").read_text(encoding="utf-8")
    return Fragment(
        f'<div class="viewer"><p class="boxes">{boxes}</p>'
        '<canvas tabindex="0" role="img" aria-label="Point clouds that turn with the mouse or the arrow keys"></canvas>'
        f'<script type="application/json">{json.dumps(data)}</script><script>\n{script}</script></div>'
    )


def _encoded(points: np.ndarray) -> str:
    return base64.b64encode(np.round(points).astype("<i2").tobytes()).decode("ascii")
