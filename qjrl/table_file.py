"""Tables that people give: columns of a CSV, arrays of an NPZ. What a table holds is decided by its names alone.

A CSV begins with a line of names, in any order, with units or without: `x`, `x [m]` and `x_m` are the same, `x_mm` is
refused. Without that line nothing says which column is which, so the file is refused. A line of numbers is a line of names
where the names are numbers (`3,7,1,5` for four cables) and it names every column once. An NPZ holds one array a quantity;
arrays of other names are let be.
"""

import dataclasses
import re
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from qjrl.config import ConfigError
from qjrl.csv_rows import NUMBER, rows_of
from qjrl.field_words import cut
from qjrl.records import reason_of

FILE_KINDS = (".csv", ".npz")

_UNIT = re.compile(r"^(.*?)(?:\s*[\[(]\s*([^\])]*?)\s*[\])]|[_\s](mm|cm|dm|km|um|µm|nm|m|inch|in|ft|deg|rad|s|ms))$")
_BRACKETS = re.compile(r"\s*[\[(][^\])]*[\])]")
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)
_FACTORS = {
    ("mm", "m"): "; divide by 1,000",
    ("cm", "m"): "; divide by 100",
    ("in", "m"): "; multiply by 0.0254",
    ("inch", "m"): "; multiply by 0.0254",
    ("ft", "m"): "; multiply by 0.3048",
    ("deg", "rad"): "; divide by 57.3",
}
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+", re.ASCII)


@dataclasses.dataclass(frozen=True)
class Quantity:
    """One array of an NPZ (n, columns), or as many columns of a CSV."""

    name: str
    """Of the array."""
    columns: tuple[str, ...]
    """Names in a CSV, in the order of the array's columns."""
    unit: str = ""
    """Of all columns; empty for a pure number."""
    aliases: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Other name of a column, in small letters -> its name."""
    order: str = ""
    """Array of an NPZ that names the columns of this one, where their order is another."""
    note: str = ""
    """What the columns are, where an NPZ has no names for them: ", w first"."""


Layout = tuple[Quantity, ...]
"""Quantities that a table may hold together."""


def read_table(path: Path, layouts: Sequence[Layout], allowed: str) -> dict[str, np.ndarray]:
    """The quantities of a table, name -> (n, columns) float64, finite, n at least 1, columns in the order of `Quantity`.

    Args:
        layouts: what the table may hold; it must hold exactly one of them.
        allowed: the same in words, of the names in a CSV.
    Raises:
        ConfigError: one line that names the file and what is wrong in it, with row and column.
    """
    return (_read_csv if path.suffix == ".csv" else _read_npz)(path, layouts, allowed)


def names_in(path: Path) -> tuple[str, ...]:
    """Names of a CSV's columns, as they are written, or of an NPZ's arrays.

    Raises:
        ConfigError: the file cannot be read.
    """
    if path.suffix == ".csv":
        rows = rows_of(path)
        return tuple(_header(path, rows[0][1])) if rows else ()
    with _archive(path) as archive:
        return tuple(archive.files)


def column_named(cell: str, quantities: Sequence[Quantity]) -> str:
    """The column that a cell of a CSV's first line names, the unit left out; empty where it names none."""
    return next((column for quantity in quantities if (column := _column_of(cell, quantity)[0])), "")


def _read_csv(path: Path, layouts: Sequence[Layout], allowed: str) -> dict[str, np.ndarray]:
    rows = rows_of(path)
    if not rows:
        raise ConfigError(f"{path}: is empty and has no header, allowed: a line of names, {allowed}")
    header = _header(path, rows[0][1])
    layout, columns = _layout_of(path, header, layouts, allowed)
    if not rows[1:]:
        raise ConfigError(f"{path}: holds a line of names and no rows below it")
    values = np.array([_numbers(path, row, line, cells, header) for row, (line, cells) in enumerate(rows[1:])])
    return {one.name: values[:, [columns.index(name) for name in one.columns]] for one in layout}


def _header(path: Path, cells: list[str]) -> list[str]:
    """The first line as names; NumPy writes a # before it."""
    cells = [cells[0].removeprefix("#").strip(), *cells[1:]]
    for separator, name in ((";", "';'"), ("\t", "tabulators"), ("|", "'|'"), (" ", "blanks")):
        if len(cells) == 1 and separator in _BRACKETS.sub("", cells[0]):
            raise ConfigError(f"{path}: its cells are separated by {name}, allowed: ',' between cells, '.' in numbers")
    return cells


def _layout_of(path: Path, header: list[str], layouts: Sequence[Layout], allowed: str) -> tuple[Layout, list[str]]:
    """The layout that a header names, and the column in every place of it."""
    quantities = [one for layout in layouts for one in layout]
    columns = [column_named(cell, quantities) for cell in header]
    for cell, column in zip(header, columns, strict=True):
        if column and columns.count(column) > 1:
            raise ConfigError(f"{path}: has the column {column} {columns.count(column)} times, allowed: once")
        if column:
            _check_unit(path, cell, column, quantities)
    for layout in layouts:
        if sorted(columns) == sorted(name for one in layout for name in one.columns):
            return layout, columns
    if all(NUMBER.fullmatch(cell) or _NOT_FINITE.fullmatch(cell) for cell in header):
        raise ConfigError(f"{path}: has no header, its first line is numbers, allowed: a line of names, {allowed}")
    raise ConfigError(
        f"{path}: has the columns {_listed(header)}, allowed: {allowed}{_difference(header, columns, layouts)}"
    )


def _difference(header: list[str], columns: list[str], layouts: Sequence[Layout]) -> str:
    """What is missing of the layout that comes nearest, and what is none of its names."""
    wanted = max(
        ([name for one in layout for name in one.columns] for layout in layouts),
        key=lambda names: len({*names} & {*columns}) - 0.5 * len({*names} - {*columns}),
    )
    if not {*wanted} & {*columns}:
        return ""
    missing = [name for name in wanted if name not in columns]
    extra = [
        (cell and _cut(cell)) or "a column without a name"
        for cell, name in zip(header, columns, strict=True)
        if name not in wanted
    ]
    said = [f"{_listed(names, ', ')} {verb}" for names, verb in ((missing, "missing"), (extra, "too much")) if names]
    return f" ({'; '.join(said)})"


def _column_of(cell: str, quantity: Quantity) -> tuple[str, str]:
    """The column of a quantity that a header's cell names, and the unit that it states."""
    whole, match = cell.casefold(), _UNIT.fullmatch(cell)
    pairs = [(whole, "")] + ([(match[1].strip().casefold(), match[2] or match[3] or "")] if match else [])
    for name, unit in pairs:
        name = quantity.aliases.get(name, name)
        if name in quantity.columns:
            return name, unit
    return "", ""


def _check_unit(path: Path, cell: str, column: str, quantities: Sequence[Quantity]) -> None:
    for quantity in quantities:
        found, unit = _column_of(cell, quantity)
        if found == column and unit not in ("", quantity.unit, quantity.unit or "-"):
            factor = _FACTORS.get((unit, quantity.unit), "")
            raise ConfigError(
                f"{path}: its column '{_cut(cell)}' is in {_cut(unit)}, allowed: {column} in {quantity.unit or 'no unit'}{factor}"
            )


def _numbers(path: Path, row: int, line: int, cells: list[str], header: list[str]) -> list[float]:
    where = f"{path}: row {row} (the first is 0), line {line}"
    if len(cells) != len(header):
        is_split = len(cells) == 2 * len(header) and all(re.fullmatch(r"[+-]?\d+", cell) for cell in cells)
        hint = "; decimal commas? write 0.5" if is_split else ""
        raise ConfigError(
            f"{where}, does not hold {len(header)} numbers but {len(cells)}, one for each of {_listed(header)}{hint}"
        )
    for cell, name in zip(cells, header, strict=True):
        if NUMBER.fullmatch(cell) and np.isfinite(float(cell)):
            continue
        if NUMBER.fullmatch(cell) or _NOT_FINITE.fullmatch(cell):
            raise ConfigError(f"{where}, column {_cut(name)}: got {_cut(cell)}, which is not finite")
        hint = "; a decimal comma? write 0.5" if _DECIMAL_COMMA.fullmatch(cell) else ""
        raise ConfigError(f"{where}, column {_cut(name)}: got {_short(cell)}, allowed: a number{hint}")
    return [float(cell) for cell in cells]


def _read_npz(path: Path, layouts: Sequence[Layout], allowed: str) -> dict[str, np.ndarray]:
    del allowed  # in the words of a CSV
    known = {one.name: one for layout in layouts for one in layout}
    with _archive(path) as archive:
        found = {name for name in archive.files if name in known}
        layout = next((layout for layout in layouts if {one.name for one in layout} == found), None)
        if layout is None:
            raise ConfigError(f"{path}: holds {_held(path, archive)}, allowed: {_arrays_allowed(layouts)}")
        arrays = {one.name: _array(path, archive, one, layouts) for one in layout}
    counts = {len(array) for array in arrays.values()}
    if len(counts) > 1:
        held = " and ".join(f"{len(array)} rows of {name}" for name, array in arrays.items())
        raise ConfigError(f"{path}: holds {held}, allowed: as many of each")
    if counts == {0}:
        raise ConfigError(f"{path}: holds no rows")
    return arrays


def _array(path: Path, archive: np.lib.npyio.NpzFile, quantity: Quantity, layouts: Sequence[Layout]) -> np.ndarray:
    array = _member(path, archive, quantity.name)
    if array.dtype.kind not in "iuf":
        raise ConfigError(f"{path}: {quantity.name} holds {array.dtype.name} values, allowed: real numbers")
    if array.ndim != 2 or array.shape[1] != len(quantity.columns):
        raise ConfigError(f"{path}: holds {_held(path, archive)}, allowed: {_arrays_allowed(layouts)}")
    is_finite = np.isfinite(array)
    if not is_finite.all():
        row, column = np.argwhere(~is_finite)[0]
        where = f"row {row} (the first is 0), column {quantity.columns[column]}"
        raise ConfigError(f"{path}: {quantity.name}, {where}: got {array[row, column]}, which is not finite")
    return array.astype(np.float64)[:, _order(path, archive, quantity)]


def _order(path: Path, archive: np.lib.npyio.NpzFile, quantity: Quantity) -> list[int]:
    """Where each column of a quantity stands in its array."""
    if quantity.order not in archive.files:
        return list(range(len(quantity.columns)))
    written = [str(name) for name in np.atleast_1d(_member(path, archive, quantity.order)).tolist()]
    columns = [_column_of(name, quantity)[0] for name in written]
    if sorted(columns) != sorted(quantity.columns):
        raise ConfigError(
            f"{path}: {quantity.order} holds {', '.join(written)}, allowed: {', '.join(quantity.columns)} in any order"
        )
    return [columns.index(name) for name in quantity.columns]


def _archive(path: Path) -> np.lib.npyio.NpzFile:
    try:
        archive = np.load(path, allow_pickle=False)
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: does not exist") from error
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigError(f"{path}: is truncated or not a .npz file ({reason_of(error)})") from error
    if not isinstance(archive, np.lib.npyio.NpzFile):
        raise ConfigError(f"{path}: is truncated or not a .npz file (it holds one array without a name)")
    return archive


def _member(path: Path, archive: np.lib.npyio.NpzFile, name: str) -> np.ndarray:
    try:
        array = archive[name]
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as error:
        if "allow_pickle" in str(error):
            raise ConfigError(f"{path}: {name} holds Python objects, allowed: real numbers") from error
        raise ConfigError(f"{path}: {name} cannot be read ({reason_of(error)})") from error
    if not isinstance(array, np.ndarray):
        raise ConfigError(f"{path}: {name} holds a text, allowed: an array of real numbers")
    return array


def _held(path: Path, archive: np.lib.npyio.NpzFile) -> str:
    return _listed([f"{name} {_shape(path, archive, name)}" for name in archive.files], ", ") or "nothing"


def _shape(path: Path, archive: np.lib.npyio.NpzFile, name: str) -> str:
    """Of an array in an error line; a file of arrays may hold anything beside those that are asked for."""
    try:
        return str(_member(path, archive, name).shape)
    except ConfigError:
        return "(no array of numbers)"


def _arrays_allowed(layouts: Sequence[Layout]) -> str:
    return ", or ".join(
        " with ".join(f"{one.name} (n, {len(one.columns)}){one.note}" for one in layout) for layout in layouts
    )


def _cut(text: str) -> str:
    return cut(text, 40)


def _listed(names: Sequence[str], between: str = ",") -> str:
    """Names in an error line, the first two dozen of them."""
    rest = f"{between}... ({len(names)} in all)" if len(names) > 24 else ""
    return between.join(map(_cut, names[:24])) + rest


def _short(cell: str) -> str:
    return _cut(repr(cell))
