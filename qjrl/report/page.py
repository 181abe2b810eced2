"""The report of a run: one HTML file that needs nothing else, made of headline, numbers, sections and provenance."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from qjrl.artifacts import write_bytes
from qjrl.report import html
from qjrl.report.canvas import as_svg, png_data_uri
from qjrl.report.html import Number
from qjrl.report.palette import DARK, LIGHT
from qjrl.report.tables import Table


@dataclasses.dataclass(frozen=True)
class Fragment:
    """HTML that stands in the page as it is, such as a viewer with its script."""

    html: str


@dataclasses.dataclass(frozen=True)
class Picture:
    """A figure, the bytes of a PNG file (a rendering) or HTML, with one sentence that says what to see."""

    content: Figure | bytes | Fragment
    caption: str
    is_wide: bool = False
    """Takes the whole width; otherwise two stand side by side where there is room."""


@dataclasses.dataclass(frozen=True)
class Section:
    """A part of the report; an empty line in `text` begins a new paragraph."""

    title: str
    text: str = ""
    numbers: tuple[Number, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()


@dataclasses.dataclass(frozen=True)
class Report:
    """Everything on the page, from top to bottom."""

    title: str
    """Name of the run, for the reader's tab and the line below the headline."""
    headline: str
    """The first line of the page: the verdict in words."""
    detail: str = ""
    """The numbers behind the headline."""
    holds: bool | None = None
    """Whether the headline is good news (green), bad (red) or neither."""
    summary: tuple[Number, ...] = ()
    warnings: tuple[str, ...] = ()
    sections: tuple[Section, ...] = ()
    durations: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Stage -> seconds."""
    provenance: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """As `provenance.json` of a stage holds it."""


def write_report(path: str | Path, report: Report) -> None:
    """Writes the page: the whole file or none of it."""
    write_bytes(path, report_page(report).encode())


def report_page(report: Report) -> str:
    """The page as text. All texts are escaped; figures are inline SVG, renderings PNG inside `data:`."""
    body = [
        _header(report),
        html.numbers_strip(report.summary, "summary"),
        html.warnings_box(report.warnings),
        html.navigation([section.title for section in report.sections]),
        *(_section(index, section) for index, section in enumerate(report.sections)),
        html.origin(report.provenance, report.durations),
    ]
    return html.page(report.title, stylesheet(), "\n".join(part for part in body if part))


def stylesheet() -> str:
    """The page's CSS: the colours of the figures, light and dark, then the rules."""
    light, dark = (html.custom_properties(colours) for colours in (LIGHT, DARK))
    rules = Path(__file__).with_name("report.css").read_text(encoding="utf-8")
    return (
        f":root {{ color-scheme: light dark; {light} }}\n"
        f"@media screen and (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}\n{rules}"
    )


def _header(report: Report) -> str:
    mood = {True: "good", False: "bad", None: "neutral"}[report.holds]
    detail = f'<p class="detail">{html.prose(report.detail)}</p>' if report.detail else ""
    return (
        f'<header class="{mood}"><h1>{html.escape(report.headline)}</h1>{detail}'
        f'<p class="title">{html.escape(report.title)}</p></header>'
    )


def _section(index: int, section: Section) -> str:
    pictures = "\n".join(
        html.figure(_drawn(picture.content, f"s{index}p{number}", picture.caption), picture.caption, picture.is_wide)
        for number, picture in enumerate(section.pictures)
    )
    parts = [
        f'<section id="{html.anchor(section.title)}"><h2>{html.escape(section.title)}</h2>',
        html.paragraphs(section.text),
        html.numbers_strip(section.numbers, "numbers"),
        *(html.table(table) for table in section.tables),
        f'<div class="pictures">{pictures}</div>' if pictures else "",
        "</section>",
    ]
    return "\n".join(part for part in parts if part)


def _drawn(content: Figure | bytes | Fragment, prefix: str, caption: str) -> str:
    if isinstance(content, Fragment):
        return content.html
    label = html.escape(caption)
    if isinstance(content, bytes):
        return f'<img src="{png_data_uri(content)}" alt="{label}">'
    return as_svg(content, prefix).replace("<svg", f'<svg role="img" aria-label="{label}"', 1)
