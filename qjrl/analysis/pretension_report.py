"""What the search for the least pretension says: numbers, tables, and the page."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from qjrl.analysis.report import Picture, Report, Section
from qjrl.analysis.report_html import Number
from qjrl.analysis.tables import Column, Table
from qjrl.control.pretension import (
    Choice,
    PretensionConfig,
    Survey,
    lowest_tension,
    needed_pretension,
    off_nominal,
)
from qjrl.control.tension_check import TensionCheck
from qjrl.control.tension_poses import PoseSet
from qjrl.robot.quaternion_arm.naming import strand_name
from qjrl.robot.verbs import Robot


def point_of(pretension: float, check: TensionCheck, poses: PoseSet) -> dict[str, float]:
    """What one pretension does over all poses [N, m, deg, shares]; of the settled ones, NaN where there are none."""
    rest, joint = check.rest, check.robot.config.joint
    settled = rest.converged
    least, off = lowest_tension(check)[settled], off_nominal(check, poses)[settled]
    bend = np.degrees(2.0 * np.arcsin(np.linalg.norm(rest.bends[settled], axis=-1)))
    return {
        "pretension": pretension,
        "safe_share": float(check.is_safe.mean()),
        "below_share": float(check.is_slack.any(axis=1).mean()),
        "slack_share": float((rest.is_slack.any(axis=1) & settled).mean()),
        "unsettled_share": float(check.is_unsettled.mean()),
        "stopped_share": float((bend > joint.bend_limit_deg + 0.5 * joint.stop_margin_deg).any(axis=1).sum() / len(settled)),
        "least_tension": _of(np.min, least),
        "median_least_tension": _of(np.median, least),
        "largest_tension": _of(np.max, rest.strand_tension[settled]),
        "largest_motor_force": _of(np.max, np.abs(rest.motor_force[settled])),
        "largest_bend_deg": _of(np.max, bend),
        "median_off_nominal": _of(np.median, off),
        "p99_off_nominal": _of(lambda values: np.percentile(values, 99), off),
        "largest_off_nominal": _of(np.max, off),
    }  # fmt: skip


def points_of(found: Survey, choice: Choice) -> list[dict[str, float]]:
    """`point_of` every pretension of the curve and of the answer, rising."""
    checks = found.checks | {choice.at: choice.check}
    return [point_of(pretension, checks[pretension], found.poses) for pretension in sorted(checks)]


def override(choice: Choice) -> str:
    """What to add to the command line, or beside the others in a robot's YAML; empty where there is no answer."""
    return "" if choice.pretension is None else f"robot.strands.pretension={choice.pretension:.10g}"


def least_by_count(config: PretensionConfig, found: Survey) -> dict[str, float | None]:
    """Number of poses -> pretension that the first so many of them need [N], interpolated on the curve; None: more than that."""
    needed = needed_pretension(config, found)
    counts = [len(needed) >> shift for shift in (4, 3, 2, 1, 0) if len(needed) >> shift]
    largest = {str(count): float(needed[:count].max()) for count in counts}
    return {count: value if np.isfinite(value) else None for count, value in largest.items()}


def metrics_of(robot: Robot, config: PretensionConfig, found: Survey, choice: Choice) -> dict[str, Any]:
    """Content of `metrics.json`."""
    own = float(robot.pretension)
    return {
        "least_pretension": choice.pretension,
        "too_little": choice.too_little,
        "override": override(choice),
        "asked": {"least_tension": config.least_tension, "share": config.share, "poses": len(found.poses)},
        "own": {"pretension": own, "message": found.checks[own].message},
        "at": {"pretension": choice.at, "message": choice.check.message, "settled_by_search": choice.num_settled},
        "curve": points_of(found, choice),
        "least_by_count": least_by_count(config, found),
        "poses_that_lose_tension": found.num_falling,
        "strands": {
            strand_name(robot, strand): {
                "own_least": _of(np.min, found.checks[own].rest.strand_tension[found.checks[own].rest.converged, strand]),
                "least": _of(np.min, choice.check.rest.strand_tension[choice.check.rest.converged, strand]),
                "largest": _of(np.max, choice.check.rest.strand_tension[choice.check.rest.converged, strand]),
            }
            for strand in range(robot.num_strands)
        },
    }  # fmt: skip


def curve_table(config: PretensionConfig, metrics: Mapping[str, Any]) -> Table:
    """One row a pretension; the answer is marked."""
    columns = (
        Column("pretension", 2, "N"),
        Column("safe", 1, "%", "poses"),
        Column(f"below {config.least_tension:g} N", 1, "%", "poses"),
        Column("slack", 1, "%", "poses"),
        Column("at a stop", 1, "%", "poses"),
        Column("never at rest", 1, "%", "poses"),
        Column("least", 1, "N", "strand"),
        Column("largest", 1, "N", "strand"),
        Column("motor", 1, "N"),
        Column("median", 2, "mm", "off the closed form"),
        Column("p99", 1, "mm", "off the closed form"),
        Column("largest", 1, "mm", "off the closed form"),
    )
    keys = ("safe_share", "below_share", "slack_share", "stopped_share", "unsettled_share")
    rows = tuple(
        (
            row["pretension"],
            *(100.0 * row[key] for key in keys),
            *(row[key] for key in ("least_tension", "largest_tension", "largest_motor_force")),
            *(1e3 * row[key] for key in ("median_off_nominal", "p99_off_nominal", "largest_off_nominal")),
        )
        for row in metrics["curve"]
    )
    answer = metrics["least_pretension"]
    marked = frozenset(index for index, row in enumerate(metrics["curve"]) if row["pretension"] == answer)
    return Table(columns, rows, marked, "* the least that is enough" if marked else "no pretension of these is enough")


def strand_table(metrics: Mapping[str, Any]) -> Table:
    """Least and largest tension of every strand over the poses."""
    own, at = metrics["own"]["pretension"], metrics["at"]["pretension"]
    columns = (
        Column("strand"),
        Column(f"least at {own:g} N", 1, "N"),
        Column(f"least at {at:g} N", 1, "N"),
        Column(f"largest at {at:g} N", 1, "N"),
    )
    return Table(columns, tuple((name, *values.values()) for name, values in metrics["strands"].items()))


def headline(config: PretensionConfig, metrics: Mapping[str, Any]) -> str:
    """The verdict in one line."""
    where = f"along {config.path}" if config.path else "over the workspace"
    poses = "every pose" if config.share == 1.0 else f"{100 * config.share:g} % of the poses"
    if metrics["least_pretension"] is None:
        at = next(row for row in metrics["curve"] if row["pretension"] == metrics["at"]["pretension"])
        return (
            f"No pretension up to {metrics['curve'][-1]['pretension']:g} N keeps {poses} safe {where}; {at['pretension']:g} N "
            f"keep {100 * at['safe_share']:.1f} %"
        )
    return (
        f"{metrics['least_pretension']:g} N of pretension keep every strand above {config.least_tension:g} N in {poses} "
        f"{where}, {metrics['too_little']:g} N do not"
    )


def on_fresh_poses(metrics: Mapping[str, Any]) -> str:
    """How far the answer holds beyond the poses that it was found on."""
    fresh = metrics["fresh"]
    return (
        f"Of {fresh['poses']} poses that the search has not seen, {100 * fresh['safe_share']:.1f} % are safe at "
        f"{fresh['pretension']:g} N; their least loaded strand carries {fresh['least_tension']:.1f} N."
    )


def pretension_report(
    config: PretensionConfig,
    metrics: Mapping[str, Any],
    pictures: Mapping[str, tuple[Figure, str]],
    provenance: Mapping[str, Any],
) -> Report:
    """The whole page."""
    own = metrics["own"]
    warnings = tuple(
        f"At {entry['pretension']:g} N: {entry['message']}." for entry in (own, metrics["at"]) if entry["message"]
    )
    row = next(row for row in metrics["curve"] if row["pretension"] == metrics["at"]["pretension"])
    details = [f"Apply it with {metrics['override']}."] if metrics["override"] else []
    details += [on_fresh_poses(metrics)] if "fresh" in metrics else []
    return Report(
        title="Pretension",
        headline=headline(config, metrics),
        detail=" ".join(details),
        holds=metrics["least_pretension"] is not None,
        summary=(
            Number("pretension", row["pretension"], "N", f"at home; described: {own['pretension']:g} N"),
            Number("least loaded strand", row["least_tension"], "N", f"{metrics['asked']['poses']} poses at rest"),
            Number("largest strand tension", row["largest_tension"], "N"),
            Number("largest motor force", row["largest_motor_force"], "N"),
        ),
        warnings=tuple(dict.fromkeys(warnings)),
        sections=(
            Section(
                "Trade-offs", _TEXT, tables=(curve_table(config, metrics),), pictures=_drawn(pictures, "trade_offs")
            ),
            Section("Tension maps", pictures=_drawn(pictures, "tip_map", "segment_map", "path")),
            Section("Strands", tables=(strand_table(metrics),)),
        ),
        provenance=provenance,
    )


def _drawn(pictures: Mapping[str, tuple[Figure, str]], *names: str) -> tuple[Picture, ...]:
    return tuple(Picture(*pictures[name], is_wide=True) for name in names if name in pictures)


def _of(function, values: np.ndarray) -> float:
    return float(function(values)) if values.size else float("nan")


_TEXT = (
    "All tensions are those at rest; moving adds the strands' friction and damping. A pose is safe where it comes to rest with "
    "every strand at least at the stated tension, none at its strength, and no motor above its force. Slack: a strand below "
    "0.01 N. At a stop: a joint bent by the tension beyond the middle between its limit and its stop, where the stop and no "
    "longer the strands hold it."
)
