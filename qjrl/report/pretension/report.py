"""The page of the search for the least pretension, its tables and its verdict, from the stage's metrics."""

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from qjrl.report.html import Number
from qjrl.report.page import Picture, Report, Section
from qjrl.report.tables import Column, Table


def curve_table(metrics: Mapping[str, Any]) -> Table:
    """One row a pretension; the answer is marked."""
    columns = (
        Column("pretension", 2, "N"),
        Column("safe", 1, "%", "poses"),
        Column(f"below {metrics['asked']['least_tension']:g} N", 1, "%", "poses"),
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


def headline(metrics: Mapping[str, Any]) -> str:
    """The verdict in one line."""
    asked = metrics["asked"]
    where = f"along {asked['path']}" if asked["path"] else "over the workspace"
    poses = "every pose" if asked["share"] == 1.0 else f"{100 * asked['share']:g} % of the poses"
    if metrics["least_pretension"] is None:
        at = next(row for row in metrics["curve"] if row["pretension"] == metrics["at"]["pretension"])
        return (
            f"No pretension up to {metrics['curve'][-1]['pretension']:g} N keeps {poses} safe {where}; {at['pretension']:g} N "
            f"keep {100 * at['safe_share']:.1f} %"
        )
    return (
        f"{metrics['least_pretension']:g} N of pretension keep every strand above {asked['least_tension']:g} N in {poses} "
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
    metrics: Mapping[str, Any],
    pictures: Mapping[str, tuple[Figure, str]],
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
        headline=headline(metrics),
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
            Section("Trade-offs", _TEXT, tables=(curve_table(metrics),), pictures=_drawn(pictures, "trade_offs")),
            Section("Tension maps", pictures=_drawn(pictures, "tip_map", "segment_map", "path")),
            Section("Strands", tables=(strand_table(metrics),)),
        ),
    )


def _drawn(pictures: Mapping[str, tuple[Figure, str]], *names: str) -> tuple[Picture, ...]:
    return tuple(Picture(*pictures[name], is_wide=True) for name in names if name in pictures)


_TEXT = (
    "All tensions are those at rest; moving adds the strands' friction and damping. A pose is safe where it comes to rest with "
    "every strand at least at the stated tension, none at its strength, and no motor above its force. Slack: a strand below "
    "0.01 N. At a stop: a joint bent by the tension beyond the middle between its limit and its stop, where the stop and no "
    "longer the strands hold it."
)
