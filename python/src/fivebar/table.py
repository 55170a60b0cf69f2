"""Tables as CSV: a header with a name for each column, then rows.

Tables are written with commas, numbers in full precision and plain names, so every CSV reader finds a variable by its name.
Tables of spreadsheets and loggers can be read too: with commas, semicolons or tabs between the columns, a decimal comma,
units in brackets or parentheses after the names, `sep=` or comments before the head, and in any encoding that `fivebar.encoding` knows.
"""

import csv
import io
import re
from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fivebar import encoding
from fivebar.errors import FiveBarError

LARGEST = 1_000_000_000
"""Largest size of a table to read, bytes."""

MISSING = frozenset(("", "nan", "-nan", "na", "n/a", "#n/a", "nat", "null"))
"""Texts of cells without a number, in lower case."""

UNIT = re.compile(r"(.+?)(?:\s+|(?!\[\d+]))\[([^][]*)]")
"""A name and its unit; a number in brackets directly after a name, as in `theta[1]`, belongs to the name."""

IN_PARENTHESES = re.compile(r"(.+?)\s*\(([^()]*)\)")
"""A name and its unit, if the unit is one of `WORDS`."""

WORDS = frozenset("s ms us ns m cm mm um N.m mN.m rpm counts rad mrad deg turns rad/s mrad/s deg/s turns/s".split())
"""Units that are recognised in parentheses, in the spelling of `spelled`; other words there may belong to the name."""

SPELLINGS = {
    "sec": "s",
    "seconds": "s",
    "µs": "us",
    "μs": "us",
    "µm": "um",
    "μm": "um",
    "Nm": "N.m",
    "mNm": "mN.m",
    "°": "deg",
    "degree": "deg",
    "degrees": "deg",
    "turn": "turns",
    "rev": "turns",
}
"""Other spellings of units and of the numerators of rates, without spaces and multiplication signs."""

DATE = re.compile(
    r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d)?)(?:(?<=:\d\d:\d\d)[.,](\d+))?\s*(Z|[+-]\d\d(?::?\d\d)?)?",
    re.ASCII | re.IGNORECASE,
)
"""An ISO 8601 date with its time of day, the decimals of its seconds and its zone."""

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

SEPARATOR = re.compile(r'"?sep=(.)"?', re.IGNORECASE)
"""First line of a spreadsheet's table: the character between the columns."""

COMMENT = "#"


@dataclass(frozen=True)
class Table:
    """Columns of numbers; NaN if a cell is empty or not finite."""

    columns: dict[str, NDArray[np.float64]]
    """The requested columns, (n) each."""

    units: dict[str, str]
    """Units in the header by column name; dates have the unit s."""

    others: list[str]
    """Names of all other columns."""

    is_dated: bool = False
    """Whether the counted column has dates."""


def read(file: Path, wanted: Collection[str], counted: str, *, numbered: bool = False) -> Table:
    """Reads the columns `wanted` and `counted` that a table has. Raises FiveBarError, with one sentence that names the file.

    The first number of the column `counted` is subtracted from the column in decimal arithmetic: at times since 1970, above
    1e9 s, floats have steps of 1e-7 s or more. This column may also have dates of ISO 8601; a date without a zone is in UTC.
    With `numbered`, a first row of numbers and dates is data, and the columns are called 1, 2, 3, ….
    """
    try:
        return _parse(encoding.read(file, LARGEST), wanted, counted, numbered)
    except FiveBarError as error:
        raise FiveBarError(f"{file}: {error}") from None


def _parse(text: str, wanted: Collection[str], counted: str, numbered: bool) -> Table:
    lines = rows(text)
    first = next(lines, [])
    head = heads(first, {*wanted, counted})
    if numbered and all(_is_number(cell) or _has_date(cell) for cell in first):
        head, lines = [(str(place), "") for place in range(1, len(first) + 1)], chain([first], lines)
    names = [name for name, _ in head]
    for name, count in Counter(filter(None, names)).items():
        if count > 1:
            raise FiveBarError(f"it has {count} columns {name:.60}; each name must be unique")
    places = {name: place for place, name in enumerate(names) if name in wanted and name != counted}
    found = {name: array("d") for name in places}
    counted_place = names.index(counted) if counted in names else None
    counts = array("d")
    origin: Decimal | None = None
    is_dated: bool | None = None
    for count, row in enumerate(lines, 1):
        if len(row) != len(head):
            comma = "; a decimal comma needs semicolons or tabs between the columns" if len(row) > len(head) else ""
            raise FiveBarError(f"row {count} has {len(row)} cells, but the head {len(head)}{comma}")
        name = counted
        try:
            if counted_place is not None:
                if is_dated is None and row[counted_place].strip().lower() not in MISSING:
                    is_dated = _has_date(row[counted_place])
                value = _date(row[counted_place]) if is_dated else _decimal(row[counted_place])
                origin = value if origin is None and value.is_finite() else origin
                counts.append(np.nan if origin is None or not value.is_finite() else float(value - origin))
            for name, place in places.items():
                found[name].append(number(row[place]))
        except (InvalidOperation, ValueError):
            cell = row[names.index(name)]
            allowed = "number"
            if name == counted:
                allowed = f"{'' if is_dated else 'number or a '}date such as 2026-11-29T10:00:00.005"
            raise FiveBarError(f"{name} in row {count} is {cell!r:.60}, which is not a {allowed}") from None
    columns = {name: np.array(column) for name, column in found.items()}
    for column in columns.values():
        column[~np.isfinite(column)] = np.nan
    if counted_place is not None:
        columns[counted] = np.array(counts)
    units = {name: unit for name, unit in head if unit} | ({counted: "s"} if is_dated else {})
    return Table(columns, units, [name for name in names if name and name not in columns], bool(is_dated))


def rows(text: str) -> Iterator[list[str]]:
    """The cells of each row that is not blank, without `sep=` and comments before the first row.

    If the first row has a number, the last comment is the head if it has as many cells and no number, as `numpy.savetxt` writes it.
    """
    lines = io.StringIO(text, newline=None)
    first, comment, separator = "", "", ""
    for first in filter(str.strip, lines):
        if first.startswith(COMMENT):
            comment = first.lstrip(COMMENT)
        elif found := SEPARATOR.fullmatch(first.strip(" \r\n")):
            separator = found[1]
        else:
            break
    else:
        first = ""
    separator = separator or next((each for each in "\t;" if each in first), ",")
    try:
        head = _first(comment, separator)
        for row in _cells(chain([first], lines), separator):
            if len(head) == len(row) and _has_number(row) and not _has_number(head):
                yield head
            head = []
            yield row
    except csv.Error as error:
        raise FiveBarError(f"it is no CSV: {error}") from None


def _cells(lines: Iterable[str], separator: str) -> Iterator[list[str]]:
    """The cells of each row that is not blank."""
    for row in csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True):
        if "".join(row).strip():
            yield row


def _first(line: str, separator: str) -> list[str]:
    """The cells of a comment; none if its quotes are not those of a table."""
    try:
        return next(_cells([line], separator), [])
    except csv.Error:
        return []


def heads(cells: Sequence[str], wanted: Collection[str] = ()) -> list[tuple[str, str]]:
    """Names and units of the columns of a table, in order; "" if there is no unit.

    A name that is in `wanted` with its unit in parentheses keeps it. A name that would not be unique without its unit keeps it too,
    unless the short name is in `wanted`: which column is meant is then open.
    """
    found = [_named(cell.strip()) for cell in cells]
    short = {
        place: (match[1], match[2].strip())
        for place, (name, _) in enumerate(found)
        if name not in wanted and (match := IN_PARENTHESES.fullmatch(name)) and spelled(match[2]) in WORDS
    }
    names = {name for name, _ in found}
    counts = Counter(name for name, _ in short.values())
    for place, (name, unit) in short.items():
        if name not in names and (counts[name] == 1 or name in wanted):
            found[place] = name, unit
    return found


def spelled(unit: str) -> str:
    """A unit from a table's head in the spelling of a map: `N.m` for `N·m`, `deg/s` for `°/s`."""
    numerator, per, denominator = "".join(c for c in unit if c not in " .·*").partition("/")
    return SPELLINGS.get(numerator, numerator) + per + denominator


def _named(cell: str) -> tuple[str, str]:
    """The name of a column and its unit in brackets, or "" if there is no unit."""
    found = UNIT.fullmatch(cell)
    return (found[1], found[2].strip()) if found else (cell, "")


def number(cell: str) -> float:
    """The number in a cell, with decimal point or comma, or NaN for a cell without number. Raises ValueError for other text."""
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


def _has_number(row: list[str]) -> bool:
    """Whether a cell has a number."""
    return any(cell.strip() and _is_number(cell) for cell in row)


def _decimal(cell: str) -> Decimal:
    """The number in a cell as a Decimal. Raises InvalidOperation for other text."""
    try:
        return Decimal(cell)
    except InvalidOperation:
        return Decimal(_pointed(cell))


def _has_date(cell: str) -> bool:
    """Whether a cell has a date."""
    return DATE.fullmatch(cell.strip()) is not None


def _date(cell: str) -> Decimal:
    """The date in a cell as s since 1970, with all its decimals, or NaN for a cell without date. Raises ValueError for other text."""
    text = cell.strip()
    if text.lower() in MISSING:
        return Decimal("nan")
    if (found := DATE.fullmatch(text)) is None:
        raise ValueError
    moment = datetime.fromisoformat(f"{found[1]}{(found[3] or 'Z').upper()}") - EPOCH
    return Decimal(86400 * moment.days + moment.seconds) + Decimal(f"0.{found[2] or 0}")


def _pointed(cell: str) -> str:
    """The cell's number in Python's notation: with a decimal point, or "nan" if the number is missing."""
    text = cell.strip().lower()
    return "nan" if text in MISSING else text.replace(",", ".")


def write_columns(file: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Writes columns of numbers, (n) each; floats have the fewest digits that restore every bit.

    About half of a run's columns are constant. Their text becomes part of the row's format, which is faster. The first column
    always counts as variable, since it determines the number of rows.
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
