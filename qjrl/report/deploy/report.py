"""The page of a deployment: verdict, numbers, animation, figures."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from qjrl.report.html import Number
from qjrl.report.page import Fragment, Picture, Report, Section
from qjrl.report.tables import Column, Table


def target_mark(target: np.ndarray, size: float = 0.006) -> np.ndarray:
    """A cross at the position of a target pose (9,) as one line (12, 3) [m]."""
    arms = size * np.concatenate([np.eye(3), -np.eye(3)])
    return target[:3] + np.stack([np.zeros_like(arms), arms], axis=1).reshape(-1, 3)


def episode_table(metrics: Mapping[str, Any]) -> Table:
    """A row for every episode."""
    columns = (
        Column("episode"),
        Column("position", 2, "mm"),
        Column("orientation", 2, "°"),
        Column("stale", 0),
        Column("not finite", 0),
        Column("implausible", 0),
        Column("longest hold", 0, "periods"),
    )
    rows = tuple(
        (
            one["name"],
            one["position_error_mm"],
            one["orientation_error_deg"],
            one["flags"]["stale"],
            one["flags"]["not_finite"] + one["flags"]["bad_answer"],
            one["flags"].get("beyond_stop", 0) + one["flags"].get("too_fast", 0),
            one["flags"]["longest_hold"],
        )
        for one in metrics["episodes"]
    )
    return Table(columns, rows)


def headline(metrics: Mapping[str, Any]) -> str:
    """The verdict in one sentence."""
    timing = metrics["timing"]
    return (
        f"The controller answers within {timing['latency_p99_ms']:.2f} ms 99 % of the time on one core; "
        f"{timing['deadlines_missed']} of {timing['periods']} deadlines missed"
    )


def deployment_report(
    title: str,
    metrics: Mapping[str, Any],
    animation: Fragment,
    figures: Mapping[str, Figure],
) -> Report:
    """The whole page; `metrics` as the stage writes them, figures "latency" and "error"."""
    timing, replayed = metrics["timing"], metrics["replay"]
    files = ", ".join(f"{name} {1e6 * one['command_difference']:.2g} µm" for name, one in metrics["parity"].items())
    return Report(
        title=title,
        headline=headline(metrics),
        detail=(
            f"Median latency {timing['latency_p50_ms']:.2f} ms, largest {timing['latency_max_ms']:.2f} ms; periods begin "
            f"{timing['jitter_p50_ms']:.2f} ms late (median), {timing['jitter_p99_ms']:.2f} ms (99 %)."
        ),
        holds=metrics["is_quick_enough"],
        summary=(
            Number("latency, 99 %", timing["latency_p99_ms"], "ms"),
            Number("deadlines missed", timing["deadlines_missed"]),
            Number("periods lost", timing["periods_lost"]),
            Number("commands replayed", 1e6 * replayed["command_deviation"], "µm", "largest deviation from the record"),
        ),
        sections=(
            Section("Watch it", pictures=(Picture(animation, _VIEWER_CAPTION, is_wide=True),)),
            Section("Episodes", _TEXT, tables=(episode_table(metrics),)),
            Section(
                "Pictures",
                f"Largest difference of the files' commands from the package's: {files}.",
                pictures=(
                    Picture(
                        figures["latency"], "Latency of the controller in every period, on one core.", is_wide=True
                    ),
                    Picture(
                        figures["error"], "Distance from the target; dots: the last command was held.", is_wide=True
                    ),
                ),
            ),
        ),
    )


_VIEWER_CAPTION = (
    "The first episode as the physics moved it; the grey cross is the target, orange where the tip has been. Drag or use "
    "the arrow keys to turn, + and - to zoom."
)
_TEXT = (
    "Each episode begins at home with a newly drawn arm (friction, gains, inertia, damping, tilt) and noise on its encoders. "
    "Errors are means over the end of the episode. In the last one readings are lost or corrupted on purpose: the last "
    "command is held until a good reading comes."
)
