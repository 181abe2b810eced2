"""Blank figures in the house style, and the ways out: PNG, data URI, SVG for the report. No pyplot, no global state."""

import base64
import io
import re
from pathlib import Path
from typing import Any, Literal

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from qjrl.artifacts import write_bytes
from qjrl.report.palette import LIGHT

PANEL = (5.2, 3.5)
"""Width and height of a figure with one plot [inch]; two stand side by side on a desk, one fills a phone."""
DPI = 110
"""Pixels of a picture per inch of its figure."""

_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so that a figure looks the same everywhere
    "font.size": 10.0,
    "axes.edgecolor": LIGHT["muted"],
    "axes.linewidth": 0.8,
    "axes.labelcolor": LIGHT["ink"],
    "axes.axisbelow": True,
    "axes.titlecolor": LIGHT["ink"],
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "grid.color": LIGHT["rule"],
    "grid.linewidth": 0.8,
    "lines.linewidth": 1.8,
    "lines.solid_capstyle": "round",
    "text.color": LIGHT["ink"],
    "xtick.color": LIGHT["muted"],
    "ytick.color": LIGHT["muted"],
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "svg.fonttype": "none",  # text stays text: readable aloud, selectable, small
    "svg.hashsalt": "qjrl",  # the same figure gives the same bytes
    "svg.image_inline": True,
}


def style():
    """Context or decorator in which figures are made and written; leaves matplotlib's settings as they were."""
    return matplotlib.rc_context(_STYLE)


def new_figure(width: float = PANEL[0], height: float = PANEL[1]) -> Figure:
    """An empty figure of so many inches, on Agg."""
    figure = Figure(figsize=(width, height), layout="constrained", facecolor=LIGHT["paper"])
    FigureCanvasAgg(figure)
    return figure


def new_plot(x_label: str, y_label: str, width: float = PANEL[0], height: float = PANEL[1]) -> tuple[Figure, Axes]:
    """A figure with one plot; the label of y lies on top, where it reads without turning. Both carry their units."""
    figure = new_figure(width, height)
    axes = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="both")
    axes.tick_params(length=0)
    axes.set_xlabel(x_label)
    axes.set_title(y_label)
    return figure, axes


def logarithmic(axes: Axes, which: Literal["x", "y"]) -> None:
    """Logarithmic axis ("x" or "y") with plain numbers, 0.01 and not a power of ten; call it when all is drawn."""
    (axes.set_xscale if which == "x" else axes.set_yscale)("log")
    axis, (low, high) = (axes.xaxis, axes.get_xlim()) if which == "x" else (axes.yaxis, axes.get_ylim())
    axis.set_major_locator(LogLocator(base=10, subs=(1.0, 2.0, 5.0) if high < 1e3 * low else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
    axes.tick_params(axis=which, which="minor", length=0)


def save_png(figure: Figure, path: str | Path, dpi: int = DPI) -> None:
    """Writes a figure as PNG: the whole file or none of it."""
    write_bytes(path, as_png(figure, dpi))


def as_png(figure: Figure, dpi: int = DPI) -> bytes:
    """A figure as the bytes of a PNG file; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with style():
        figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()


def png_data_uri(png: bytes) -> str:
    """The bytes of a PNG file as `data:image/png;base64,…`."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def as_svg(figure: Figure, prefix: str) -> str:
    """A figure as an `<svg>` element to stand inside an HTML page; its colours are CSS variables (`--ink`, …).

    Args:
        prefix: makes its ids differ from those of the other figures of the page.
    """
    buffer = io.StringIO()
    with style():
        figure.savefig(buffer, format="svg", transparent=True, dpi=180)  # of what is drawn as pixels
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", svg, flags=re.DOTALL)  # its style rules the page
    svg = re.sub(r' xmlns(:xlink)?="[^"]*"', "", svg).replace("xlink:href=", "href=")
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = _own_ids(svg, prefix)
    for name, colour in LIGHT.items():
        svg = svg.replace(colour, f"var(--{name})")
    return svg.replace("'DejaVu Sans'", "inherit")


def _own_ids(svg: str, prefix: str) -> str:
    """Ids that something refers to get the prefix, the rest goes."""
    used = set(re.findall(r'(?:url\(|href=")#([^")]+)', svg))
    svg = re.sub(r' id="([^"]*)"', lambda match: f' id="{prefix}-{match[1]}"' if match[1] in used else "", svg)
    return re.sub(r'(url\(|href=")#', rf"\g<1>#{prefix}-", svg)
