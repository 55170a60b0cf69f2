"""Tables as CSV: a head with a name for each column, then rows.

They are written with commas, numbers in full precision, and plain names, so that every reader of CSV finds a variable by its name. They are
read as spreadsheets and loggers write them as well: with commas, semicolons or tabs between the columns, with a decimal comma, with units in
brackets behind the names, and in any encoding that `fivebar.encoding` knows.
"""

import csv
import io
import re
from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fivebar import encoding
from fivebar.errors import FiveBarError

LARGEST = 1_000_000_000
"""Bytes of a table that is read, at most."""

MISSING = frozenset(("", "nan", "-nan", "na", "n/a", "#n/a", "null"))
"""Cells without a number, in small letters."""

UNIT = re.compile(r"(.+?)(?:\s+|(?!\[\d+]))\[([^][]*)]")
"""A name and its unit; a number in brackets right behind a name, as in `theta[1]`, belongs to the name."""


@dataclass(frozen=True)
class Table:
    """Columns of numbers; NaN if a cell is empty or not finite."""

    columns: dict[str, NDArray[np.float64]]
    """The requested columns, (n) each."""

    units: dict[str, str]
    """Units in the head, by the column's name."""

    others: list[str]
    """Names of all other columns."""


def read(file: Path, wanted: Collection[str], counted: str, *, numbered: bool = False) -> Table:
    """Reads the columns `wanted` and `counted`, as far as a table has them. Raises FiveBarError, with one sentence that names the file.

    The column `counted` counts from its first number, which is subtracted as a decimal: beyond 1e9, as times since 1970 are, floats have steps of 1e-7.
    With `numbered`, a first row of numbers is no head: the columns are then called 1, 2, 3, ….
    """
    try:
        return _parse(encoding.read(file, LARGEST), wanted, counted, numbered)
    except FiveBarError as error:
        raise FiveBarError(f"{file}: {error}") from None


def _parse(text: str, wanted: Collection[str], counted: str, numbered: bool) -> Table:
    lines = rows(text)
    first = next(lines, [])
    head = [named(cell) for cell in first]
    if numbered and all(map(_is_number, first)):
        head, lines = [(str(place), "") for place in range(1, len(first) + 1)], chain([first], lines)
    names = [name for name, _ in head]
    for name, count in Counter(filter(None, names)).items():
        if count > 1:
            raise FiveBarError(f"it has {count} columns {name:.60}; each name may stand in the head once")
    places = {name: place for place, name in enumerate(names) if name in wanted and name != counted}
    found = {name: array("d") for name in places}
    counted_place = names.index(counted) if counted in names else None
    counts = array("d")
    origin: Decimal | None = None
    for count, row in enumerate(lines, 1):
        if len(row) != len(head):
            comma = "; a decimal comma needs semicolons or tabs between the columns" if len(row) > len(head) else ""
            raise FiveBarError(f"row {count} has {len(row)} cells, and the head {len(head)}{comma}")
        name = counted
        try:
            if counted_place is not None:
                value = _decimal(row[counted_place])
                origin = value if origin is None and value.is_finite() else origin
                counts.append(np.nan if origin is None or not value.is_finite() else float(value - origin))
            for name, place in places.items():
                found[name].append(number(row[place]))
        except (InvalidOperation, ValueError):
            cell = row[names.index(name)]
            raise FiveBarError(f"{name} in row {count} is {cell!r:.60}, which is no number") from None
    columns = {name: np.array(column) for name, column in found.items()}
    for column in columns.values():
        column[~np.isfinite(column)] = np.nan
    if counted_place is not None:
        columns[counted] = np.array(counts)
    units = {name: unit for name, unit in head if unit}
    return Table(columns, units, [name for name in names if name and name not in columns])


def rows(text: str) -> Iterator[list[str]]:
    """The cells of each row that is not blank."""
    lines = io.StringIO(text, newline=None)
    first = next((line for line in lines if line.strip()), "")
    separator = next((each for each in "\t;" if each in first), ",")
    try:
        for row in csv.reader(chain([first], lines), delimiter=separator, skipinitialspace=True, strict=True):
            if "".join(row).strip():
                yield row
    except csv.Error as error:
        raise FiveBarError(f"it is no CSV: {error}") from None


def named(cell: str) -> tuple[str, str]:
    """The name of a column and its unit, or "" without one."""
    found = UNIT.fullmatch(cell.strip())
    return (found[1], found[2].strip()) if found else (cell.strip(), "")


def number(cell: str) -> float:
    """The number in a cell, with a point or a comma, or NaN if there is none. Raises ValueError if there is something else."""
    try:
        return float(cell)
    except ValueError:
        return float(_pointed(cell))


def _is_number(cell: str) -> bool:
    """Whether a cell has a number or is empty."""
    try:
        number(cell)
    except ValueError:
        return False
    return True


def _decimal(cell: str) -> Decimal:
    """The number in a cell as a decimal. Raises InvalidOperation."""
    try:
        return Decimal(cell)
    except InvalidOperation:
        return Decimal(_pointed(cell))


def _pointed(cell: str) -> str:
    """The cell's text in Python's notation of numbers."""
    text = cell.strip().lower()
    return "nan" if text in MISSING else text.replace(",", ".")


def write_columns(file: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Writes columns of numbers, (n) each; floats have the shortest digits that give back every bit.

    Of a run, every second column never changes: its text becomes a part of the row's format. The first column counts the rows.
    """
    cells: list[str] = []
    changing: list[list[object]] = []
    for column in columns.values():
        if changing and len(column) and column.tobytes() == column[:1].tobytes() * len(column):
            cells.append(repr(column[0].item()))
        else:
            cells.append("%r")
            changing.append(column.tolist())
    row = ",".join(cells) + "\n"
    with file.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerow(columns)
        stream.writelines(map(row.__mod__, zip(*changing)))


def write(file: Path, names: Iterable[str], lines: Iterable[Sequence[object]]) -> None:
    """Writes a table; numbers have enough digits to restore every bit of a double."""
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(lines)
