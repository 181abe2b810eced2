"""The rows of a CSV as texts, whoever wrote it: NumPy, a spreadsheet, another program."""

import csv
import io
import re
from pathlib import Path

from qjrl.config import ConfigError
from qjrl.text_file import NotUTF8, read_text

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def rows_of(path: Path) -> list[tuple[int, list[str]]]:
    """Number of its last line, from 1, and cells of every row; empty lines, comments above the names and Excel's line are left out.

    Raises:
        ConfigError: the file cannot be read, is not in UTF-8, or a quote in it is not closed; one line.
    """
    try:
        reader = csv.reader(io.StringIO(read_text(path), newline=""))
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if "".join(row).strip()]
    except (OSError, NotUTF8, csv.Error) as error:
        raise ConfigError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    last = 0
    for line, row in rows:
        if line > last + 1 and any("\n" in cell for cell in row):
            raise ConfigError(f"{path}: line {last + 1}: a quote is not closed there, allowed: cells on one line")
        last = line
    return rows[_preamble([row for _, row in rows]) :]


def _preamble(rows: list[list[str]]) -> int:
    """How many lines stand before the names: Excel's ``sep=,`` and comments; NumPy writes a # before the names too."""
    start = int(rows[:1] == [["sep=", ""]])
    while len(rows) > start + 1 and rows[start][0].startswith("#"):
        below = rows[start + 1]
        if not below[0].startswith("#") and (len(below) == len(rows[start]) or NUMBER.fullmatch(below[0])):
            break
        start += 1
    return start
