"""What a stage has made, and the one function that writes it: metrics, arrays, tables, figures, pages.

Numbers are written before anything is drawn: where a drawing fails, they are there. Drawing is imported where there is
something to draw: a stage without figures does not load matplotlib.
"""

import dataclasses
import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from qjrl import artifacts
from qjrl.provenance import read_provenance
from qjrl.report.tables import Table, as_markdown, as_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from qjrl.report.page import Report

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Drawn:
    """Pictures and pages of a stage. A mapping is name -> content, the name without the ending of the file."""

    figures: Mapping[str, "Figure"] = dataclasses.field(default_factory=dict)
    """`NAME.png`."""
    pages: Mapping[str, "Report"] = dataclasses.field(default_factory=dict)
    """`NAME.html`; each gets the provenance of the stage."""


@dataclasses.dataclass(frozen=True)
class Output:
    """What a stage has made. A mapping is name -> content, the name without the ending of the file."""

    metrics: Mapping[str, Any] | None = None
    """`metrics.json`; None: no such file."""
    arrays: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)
    """`NAME.npz`: name -> array."""
    draw: Callable[[], Drawn] | None = None
    """Called when all numbers are written."""
    tables: Mapping[str, Sequence[Table]] = dataclasses.field(default_factory=dict)
    """`NAME.md`; they are logged too."""
    records: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """`NAME.json` beside the metrics."""
    files: Mapping[str, bytes] = dataclasses.field(default_factory=dict)
    """Any other file, by its whole name."""
    shown: Sequence[Table | str] = ()
    """Tables and lines for the log alone, after `tables`."""


def write_output(output: Output, out: Path) -> None:
    """Writes the files of a stage into its directory, each whole or not at all, and logs its tables and lines."""
    for name, content in output.files.items():
        artifacts.write_bytes(out / name, content)
    for name, arrays in output.arrays.items():
        artifacts.write_arrays(out / f"{name}.npz", arrays)
    for name, record in output.records.items():
        artifacts.write_json(out / f"{name}.json", record)
    if output.metrics is not None:
        artifacts.write_json(out / "metrics.json", output.metrics)
    for name, tables in output.tables.items():
        artifacts.write_bytes(out / f"{name}.md", "\n".join(map(as_markdown, tables)).encode())
    if output.draw is not None:
        _write_drawn(output.draw(), out)
    for shown in (*(table for tables in output.tables.values() for table in tables), *output.shown):
        log.info("%s", f"{as_text(shown)}\n" if isinstance(shown, Table) else shown)


def _write_drawn(drawn: Drawn, out: Path) -> None:
    from qjrl.report.canvas import save_png
    from qjrl.report.page import write_report

    for name, figure in drawn.figures.items():
        save_png(figure, out / f"{name}.png")
    for name, page in drawn.pages.items():
        write_report(out / f"{name}.html", dataclasses.replace(page, provenance=read_provenance(out)))
