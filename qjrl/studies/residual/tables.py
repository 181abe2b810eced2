"""Tables of the residual study."""

from collections.abc import Mapping
from typing import Any

from qjrl.report.outcomes import TARGET_SET_LABELS
from qjrl.report.tables import Column, Table


def tuning_table(found: Mapping[float, Mapping[str, float]]) -> Table:
    """The baseline's errors by the gain of its integral."""
    columns = (
        Column("gain of the baseline", 2, "1/s"),
        *(column for label in TARGET_SET_LABELS.values() for column in _columns(label)),
    )
    rows = tuple((gain, *_cells(errors)) for gain, errors in found.items())
    return Table(columns, rows, note="Learned IK with integral feedback.")


def effects_table(effects: Mapping[str, Mapping[str, float]]) -> Table:
    """The base's errors under each randomised parameter alone."""
    columns = (
        Column("randomised alone"),
        *(column for label in TARGET_SET_LABELS.values() for column in _columns(label)),
    )
    rows = tuple((name.replace("_", " "), *_cells(errors)) for name, errors in effects.items())
    return Table(columns, rows, note="Learned IK without feedback.")


def ablation_table(found: Mapping[str, Mapping[str, Any]]) -> Table:
    """Policy against its base, for each ablation."""
    columns = (
        Column("ablation"),
        Column("controller"),
        *(column for label in TARGET_SET_LABELS.values() for column in _columns(label)),
    )
    rows = tuple(
        (name if controller == "base" else "", controller, *_cells(errors))
        for name, both in found.items()
        for controller, errors in both.items()
    )
    return Table(columns, rows, note="Base and policy of a pair have the same targets, arms and noise.")


def _columns(group: str) -> tuple[Column, ...]:
    return (
        Column(f"{group}, median", 3, "mm"),
        Column("p90", 3, "mm"),
        Column("median", 3, "°"),
    )


def _cells(errors: Mapping[str, float]) -> tuple[float, ...]:
    quantities = ("median_mm", "p90_mm", "median_deg")
    return tuple(errors[f"{name}_{quantity}"] for name in TARGET_SET_LABELS for quantity in quantities)
