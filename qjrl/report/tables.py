"""A table of results, once: as aligned text for the terminal, as Markdown for a page, as HTML in the report."""

import dataclasses

Cell = str | float | int | None


@dataclasses.dataclass(frozen=True)
class Column:
    """One column; numbers in it share their decimals, so that they can be compared at a glance."""

    header: str
    decimals: int | None = None
    """Digits after the point; None for texts."""
    unit: str = ""
    group: str = ""
    """Words above neighbouring columns of the same group, in HTML."""

    @property
    def is_number(self) -> bool:
        """Whether its cells are numbers, aligned to the right."""
        return self.decimals is not None

    def text(self, cell: Cell) -> str:
        """A cell as shown: "<0.01" where rounding would hide that a number is not zero, "–" for none."""
        if cell is None or isinstance(cell, str):
            return cell or "–"
        if self.decimals is None:
            return str(cell)
        smallest = 10.0**-self.decimals
        if 0.0 < abs(cell) < 0.5 * smallest:
            return f"<{smallest:.{self.decimals}f}"
        return f"{cell:,.{self.decimals}f}"


@dataclasses.dataclass(frozen=True)
class Table:
    """Columns and rows; marked rows stand out."""

    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    marked: frozenset[int] = frozenset()
    note: str = ""
    """One line below the table: what the mark means, what was left out."""

    def __post_init__(self):
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"row {row}: got {len(row)} cells, allowed: {len(self.columns)}")

    @property
    def texts(self) -> list[list[str]]:
        """All cells as shown."""
        return [[column.text(cell) for column, cell in zip(self.columns, row, strict=True)] for row in self.rows]


def as_markdown(table: Table) -> str:
    """Lines of a Markdown table, marked rows bold, the note below; with a trailing newline."""
    headers, rule = _headers(table), ["--:" if column.is_number else "---" for column in table.columns]
    body = [
        [f"**{cell}**" for cell in cells] if row in table.marked else cells for row, cells in enumerate(table.texts)
    ]
    lines = ["| " + " | ".join(cells) + " |" for cells in (headers, rule, *body)]
    return "\n".join([*lines, *(["", table.note] if table.note else [])]) + "\n"


def as_text(table: Table) -> str:
    """Monospace lines: texts to the left, numbers to the right, the unit behind the header; no trailing newline."""
    headers, texts = _headers(table), table.texts
    widths = [max(len(line[index]) for line in [headers, *texts]) for index in range(len(headers))]

    def line(cells: list[str], mark: str = "") -> str:
        aligned = [
            cell.rjust(width) if column.is_number else cell.ljust(width)
            for cell, width, column in zip(cells, widths, table.columns, strict=True)
        ]
        return ("  ".join(aligned) + mark).rstrip()

    rule = "  ".join("─" * width for width in widths)
    body = [line(cells, " *" * (row in table.marked)) for row, cells in enumerate(texts)]
    return "\n".join([line(headers), rule, *body, *([table.note] if table.note else [])])


def _headers(table: Table) -> list[str]:
    return [f"{column.header} [{column.unit}]" if column.unit else column.header for column in table.columns]
