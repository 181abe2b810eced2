"""The pieces of the report's page as HTML; every text that enters is escaped here."""

import dataclasses
import json
import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from qjrl.report.tables import Column, Table


@dataclasses.dataclass(frozen=True)
class Number:
    """A number that deserves a large face."""

    label: str
    value: str | float
    unit: str = ""
    note: str = ""
    """Small print below it."""


def page(title: str, stylesheet: str, body: str) -> str:
    """The whole document; `stylesheet` and `body` are HTML already."""
    return f"""<!doctype html>
<html lang="en-GB">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>
{stylesheet}</style>
</head>
<body>
<main>
{body}
</main>
</body>
</html>
"""


def custom_properties(colours: Mapping[str, str]) -> str:
    """Colours as CSS variables."""
    return " ".join(f"--{name}: {colour};" for name, colour in colours.items())


def numbers_strip(numbers: Sequence[Number], kind: str) -> str:
    """Large numbers in a row, each with its label and unit."""
    if not numbers:
        return ""
    items = []
    for number in numbers:
        value = number.value if isinstance(number.value, str) else three_digits(number.value)
        unit = f' <span class="unit">{escape(number.unit)}</span>' if number.unit else ""
        if number.unit == "°":
            unit = "°"
        note = f'<dd class="note">{escape(number.note)}</dd>' if number.note else ""
        items.append(f"<div><dt>{escape(number.label)}</dt><dd>{escape(value)}{unit}</dd>{note}</div>")
    return f'<dl class="{kind}">{"".join(items)}</dl>'


def warnings_box(warnings: Sequence[str]) -> str:
    """What a reader must know before believing the numbers."""
    if not warnings:
        return ""
    items = "".join(f"<li>{prose(warning)}</li>" for warning in warnings)
    return f'<aside class="warnings"><h2>To be read with the numbers</h2><ul>{items}</ul></aside>'


def navigation(titles: Sequence[str]) -> str:
    """Links to the sections."""
    if len(titles) < 2:
        return ""
    links = "".join(f'<a href="#{anchor(title)}">{escape(title)}</a>' for title in [*titles, "Origin"])
    return f'<nav aria-label="Sections">{links}</nav>'


def anchor(title: str) -> str:
    """A title as an id."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-") or "section"


def paragraphs(text: str) -> str:
    """Paragraphs, apart by an empty line."""
    blocks = [block.strip() for block in re.split(r"\n\s*\n", text) if block.strip()]
    return "\n".join(f"<p>{prose(block)}</p>" for block in blocks)


def prose(text: str) -> str:
    """Escaped text in which no line ends between a number and its unit."""
    return re.sub(r"(\d) (mm|m|N|°|%|s|min|times)(?!\w)", "\\1\u00a0\\2", escape(text))


def figure(content: str, caption: str, is_wide: bool) -> str:
    """A picture (HTML already) with its caption."""
    kind = ' class="wide"' if is_wide else ""
    return f'<figure{kind}><div class="picture">{content}</div><figcaption>{prose(caption)}</figcaption></figure>'


def table(content: Table) -> str:
    """A table with right-aligned numbers; a first cell that repeats the one above is greyed."""
    body, all_texts = [], content.texts
    last_text = max((place for place, column in enumerate(content.columns) if not column.is_number), default=0)
    for index, texts in enumerate(all_texts):
        repeats = index > 0 and texts[0] == all_texts[index - 1][0]
        if index in content.marked:
            texts[last_text] += " *"
        cells = [
            f'<td class="{"number" if column.is_number else "text"}{" repeated" if repeats and not place else ""}">'
            f"{escape(text)}</td>"
            for place, (column, text) in enumerate(zip(content.columns, texts, strict=True))
        ]
        kinds = " ".join(["marked"] * (index in content.marked) + ["first"] * (index > 0 and not repeats))
        body.append(f'<tr class="{kinds}">{"".join(cells)}</tr>' if kinds else f"<tr>{''.join(cells)}</tr>")
    note = f'<p class="note">{prose(content.note)}</p>' if content.note else ""
    rows = "\n".join(body)
    return f'<div class="table"><table>{_head(content.columns)}<tbody>\n{rows}\n</tbody></table></div>{note}'


def _head(columns: Sequence[Column]) -> str:
    """One row of headers, and above it the groups where there are any."""
    headers = "".join(
        f'<th scope="col" class="{"number" if column.is_number else "text"}">{escape(column.header)}'
        + (f' <span class="unit">[{escape(column.unit)}]</span>' if column.unit else "")
        + "</th>"
        for column in columns
    )
    groups = [[columns[0].group, 0]]
    for column in columns:
        if column.group != groups[-1][0]:
            groups.append([column.group, 0])
        groups[-1][1] += 1
    if not any(name for name, _ in groups):
        return f"<thead><tr>{headers}</tr></thead>"
    above = "".join(
        f'<th scope="colgroup" colspan="{span}" class="group"><span>{escape(name)}</span></th>'
        if name
        else f'<td colspan="{span}"></td>'
        for name, span in groups
    )
    return f'<thead><tr class="groups">{above}</tr><tr>{headers}</tr></thead>'


def origin(provenance: Mapping[str, Any], durations: Mapping[str, float]) -> str:
    """Where the numbers come from: code, versions, hardware, seed, times, and the whole configuration."""
    entries = {words(key): _entry(value) for key, value in provenance.items() if key not in ("config", "inputs")}
    if durations:
        entries["Durations"] = _entry({stage: clock(seconds) for stage, seconds in durations.items()})
    if not entries and "config" not in provenance:
        return ""
    items = "".join(f"<dt>{escape(key)}</dt><dd>{value}</dd>" for key, value in entries.items())
    config = json.dumps(provenance.get("config", {}), indent=2, default=str, ensure_ascii=False)
    details = f"<details><summary>Configuration</summary><pre>{escape(config)}</pre></details>"
    return f'<section id="origin"><h2>Origin</h2><dl class="origin">{items}</dl>{details}</section>'


def _entry(value: Any) -> str:
    """A value of the provenance: a mapping as pairs in a row, anything else as text."""
    if isinstance(value, Mapping):
        pairs = [
            f'<span class="pair"><span class="key">{escape(words(key, False))}</span> {_entry(item)}</span>'
            for key, item in value.items()
        ]
        return " ".join(pairs)
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    text = str(value)
    return f"<code>{escape(text)}</code>" if re.fullmatch(r"[0-9a-f]{12,}", text) else escape(text)


def words(key: str, is_capital: bool = True) -> str:
    """A key as people write it."""
    text = key.replace("_gib", " [GiB]").replace("_", " ")
    text = text.replace("cpu", "CPU").replace("gpu", "GPU") if text in ("cpu", "gpu") else text
    return text[:1].upper() + text[1:] if is_capital else text


def clock(seconds: float) -> str:
    """A duration as 12 s, 3:05 min or 1:02:03 h."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours}:{minutes:02d}:{rest:02d} h"
    return f"{minutes}:{rest:02d} min" if minutes else f"{rest} s"


def three_digits(value: float) -> str:
    """A number with three digits that count, thousands apart; counts as they are."""
    if value == round(value) or abs(value) >= 1000:
        return f"{value:,.0f}"
    return f"{value:.3g}" if abs(value) < 1e-3 else f"{value:.{max(0, 2 - _magnitude(value))}f}"


def _magnitude(value: float) -> int:
    return int(f"{abs(value):e}".partition("e")[2])
