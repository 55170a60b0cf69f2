"""Recordings: a machine's samples sorted by time, with columns named as the fields of `meas`.

`read` reads a table (CSV or Parquet); readers of other sources pass clock and columns to `of`, which applies the same rules to all. If a clock goes back, it
was restarted: the following samples are another series, and `time` appends the series to each other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fivebar import table
from fivebar.errors import FiveBarError, warn
from fivebar.twin import units
from fivebar.twin.errors import TwinError
from fivebar.twin.messages import INPUTS, MEAS_FIELDS, MEASURED
from fivebar.variables import shown

Array = NDArray[Any]

TIME: Final = "time"

UNITS: Final = {TIME: "s", "theta": "rad", "omega": "rad/s", "tau": "N.m", "tip.x": "m", "tip.y": "m"}
"""Units of the columns, by the end of their names."""

TRUE: Final = {name.removeprefix("measured."): name for name in MEASURED}
"""Columns of a simulated run: each replaces a missing measured column."""

COLUMNS: Final = frozenset({TIME, *MEAS_FIELDS, *TRUE})
"""Names of the columns that are read."""

GIVEN: Final = "the record"
"""Name in messages of a record without a file."""

SLOW: Final = 0.5
"""Limit of a plausible sampling period, s: machines are sampled faster, and times in ms look slower."""

FEWEST: Final = 20
"""Minimum number of samples of a series that is calibrated, or that has a rate of its own."""

MANY_REPEATED: Final = 0.1
"""Share of the samples with the time of the row above, above which the time is coarse: a logger seldom writes a time twice."""

ALIKE: Final = 0.1
"""Difference of two sampling periods of one rate, relative to the shorter one."""

DISORDER: Final = 0.1
"""Share of steps back in time, above which rows are not sorted: a series between two restarts has 20 samples or more."""

MOST_DEGREES: Final = 720.0
"""Whole numbers beyond two turns in degrees are counts of an encoder."""

SHOWN: Final = 8
"""Maximum number of other columns named in a note."""


class WrongUnit(TwinError):
    """Numbers that look like another unit than the expected one."""

    def __init__(self, source: str | Path, question: str, name: str, unit: str):
        super().__init__(f"{source}: {question}")
        self.question, self.name, self.unit = question, name, unit
        """The question, the variable (or `TIME`) and the probable unit as a map writes it."""


@dataclass(frozen=True)
class Recording:
    """Samples of a machine."""

    source: str | Path
    """File or folder, for error messages."""

    time: Array
    """(n), s from the first sample, rising. At a restart of the clock, the step is the median step."""

    columns: dict[str, Array]
    """Fields of `meas` by name, (n) each: rad, rad/s, N.m, m; NaN if a sample has no value. Drive commands have no NaN: each holds until the next one."""

    begins: tuple[int, ...]
    """Indices of the first samples after each restart of the clock."""

    notes: list[str]
    """Sentences about ignored rows and columns."""

    coarse: str = ""
    """The note about samples that share a time, if they are more than `MANY_REPEATED` of all, else ""."""

    def part(self, first: int, last: int) -> "Recording":
        """Samples first to last - 1; times stay."""
        columns = {name: column[first:last] for name, column in self.columns.items()}
        begins = tuple(begin - first for begin in self.begins if first < begin < last)
        return replace(self, time=self.time[first:last], columns=columns, begins=begins)

    @property
    def period(self) -> float:
        """Median sampling period, s; 0 for a single sample."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else 0.0

    @property
    def periods(self) -> Array:
        """(n), s: median sampling period of the series of each sample; of the whole recording if the series has less than `FEWEST` samples."""
        found = np.full(len(self.time), self.period)
        for begin, end in pairwise((0, *self.begins, len(self.time))):
            if end - begin >= FEWEST:
                found[begin:end] = np.median(np.diff(self.time[begin:end]))
        return found


def distinct(periods: Array) -> list[float]:
    """Periods that differ by more than `ALIKE`, rising."""
    found: list[float] = []
    for period in np.unique(periods).tolist():
        if not found or period > (1 + ALIKE) * found[-1]:
            found.append(period)
    return found


def read(file: Path) -> Recording:
    """Reads a table, CSV or Parquet, with the columns `time` in s, measured.theta[1] and measured.theta[2] (or theta[1] and theta[2]) in rad, and other fields of `meas`."""
    # Imported here because a process without recordings does not need pyarrow.
    from fivebar.twin import record

    try:
        is_parquet = record.is_record(file)
        if file.is_dir():
            raise TwinError(f"{file} is a folder, but a table (CSV or Parquet) is expected")
        if is_parquet and record.is_of_twin(file):
            raise TwinError(f"{file} is a record of `fivebar twin`, but a table (CSV or Parquet) is expected")
        found = record.table_of(file, COLUMNS, TIME) if is_parquet else table.read(file, COLUMNS, TIME)
    except FiveBarError as error:
        raise TwinError(str(error)) from None
    columns, in_head = dict(found.columns), dict(found.units)
    if is_parquet and in_head.get(TIME) == "ns":
        # Dates and durations.
        columns[TIME], in_head[TIME] = 1e-9 * columns[TIME], "s"
    for name in columns:
        unit, given = _unit(name), in_head.get(name, "")
        if given and table.spelled(given) != unit:
            raise TwinError(f"{file}: {name} is in {given:.20}, but {unit} is expected")
    if TIME not in columns:
        names = ", ".join([*columns, *found.others])[:200] or "nothing"
        hint = "" if is_parquet else "; commas, semicolons or tabs separate columns"
        raise TwinError(f"{file} has no column time (s); its head is {names}{hint}")
    return _of_table(file, columns, found.others)


def of_columns(given: Any) -> Recording:
    """The recording in the columns of a dict or of a frame of pandas, called as those of a table.

    The frame's index may be the time; times may be dates or durations.
    """
    if not isinstance(given, Mapping) and not (hasattr(given, "columns") and hasattr(given, "index")):
        raise TwinError(f"a record is a file, a dict of columns or a frame of pandas, not {shown(given)}")
    found = {str(name): given[name] for name in (given if isinstance(given, Mapping) else given.columns)}
    if TIME not in found and getattr(getattr(given, "index", None), "name", None) == TIME:
        found[TIME] = given.index
    columns = {
        name: _numbers(name, _seconds(column) if name == TIME else column)
        for name, column in found.items()
        if name in COLUMNS
    }
    if TIME not in columns:
        raise TwinError(f"{GIVEN} has no column time (s); it has {', '.join(found)[:200] or 'nothing'}")
    for name, column in columns.items():
        if len(column) != len(columns[TIME]):
            raise TwinError(
                f"{GIVEN} has {len(columns[TIME])} values of time but {len(column)} of {name}: the counts must be equal"
            )
    return _of_table(GIVEN, columns, [name for name in found if name not in COLUMNS])


def _seconds(given: Any) -> Any:
    """Dates and durations as s since the first one, NaN if one is missing; anything else as it is."""
    try:
        found = np.asarray(given)
        for dates, kind in ((datetime, "datetime64[ns]"), (timedelta, "timedelta64[ns]")):
            known = [t for t in found.flat if t is not None] if found.dtype == object else []
            if known and all(isinstance(t, dates) for t in known):
                found = np.array([_without_zone(t) for t in found], dtype=kind)
    except (TypeError, ValueError, OverflowError):
        return given
    if found.dtype.kind not in "mM" or found.ndim != 1 or not len(found):
        return given
    missing = np.isnat(found)
    ns = (found - found[np.argmin(missing)]).astype("timedelta64[ns]").astype(np.int64)
    return np.where(missing, np.nan, 1e-9 * ns)


def _without_zone(given: Any) -> Any:
    """A date with a zone as the date in UTC; anything else as it is."""
    is_aware = isinstance(given, datetime) and given.tzinfo is not None
    return given.astimezone(UTC).replace(tzinfo=None) if is_aware else given


def _numbers(name: str, given: Any) -> Array:
    try:
        column = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        column = np.empty(())
    if column.ndim != 1:
        raise TwinError(f"{GIVEN}: {name} must be a column of numbers, not {shown(given)}")
    return column


def _of_table(source: str | Path, columns: dict[str, Array], unused: Sequence[str]) -> Recording:
    """The recording of columns by name, the clock among them; `unused` are the names of others."""
    clock = columns.pop(TIME)
    for other, name in TRUE.items():
        angle = columns.pop(other, None)
        if angle is not None:
            columns.setdefault(name, angle)
    encoders = [columns[name] for name in MEASURED if name in columns]
    if not encoders:
        raise TwinError(
            f"{source} has no column {MEASURED[0]} or {MEASURED[1]}; its columns are {', '.join([TIME, *columns, *unused])[:200]}; "
            "`fivebar import --map` reads columns of other names"
        )
    if not any(np.isfinite(column).any() for column in encoders):
        raise TwinError(f"{source} has no number in {MEASURED[0]} or {MEASURED[1]}")
    meant = {_letters(name): TRUE.get(name, name) for name in COLUMNS}
    for other in unused:
        probable = meant.get(_letters(other))
        if probable is not None and probable not in columns:
            warn(f"{source}: the column {other} is not used, and there is no {probable}: is this column meant?")
    listed = [*unused[:SHOWN], *([f"{len(unused) - SHOWN} more"] if len(unused) > SHOWN else [])]
    return of(source, clock, columns, [f"columns that are not used: {', '.join(listed)}"] if listed else [])


def of(source: str | Path, clock: Array, columns: dict[str, Array], notes: list[str]) -> Recording:
    """Makes a recording from samples in order and their clock, s. Raises `TwinError` for rows that are not sorted and for times and angles in other units."""
    usable = np.flatnonzero(np.isfinite(clock))
    own = usable[np.diff(clock[usable], prepend=np.nan) != 0]
    if not len(own):
        raise TwinError(f"{source} has no row with a time")
    if len(own) < FEWEST <= len(usable):
        raise TwinError(
            f"{source}: {len(usable)} rows with a time have {len(own)} different time{'s' if len(own) > 1 else ''}; {FEWEST} or more are needed: "
            "the time column has too few digits"
        )
    left_out, other = len(clock) - len(own), _repeated(clock, columns, usable)
    coarse = ""
    if other > MANY_REPEATED * len(usable):
        repeated = len(usable) - len(own)
        left_out -= repeated
        coarse = (
            f"{repeated} of {len(usable)} samples are left out, because they repeat the time of the row above, {other} of them with other readings: "
            "the time column has too few digits, or rows are stamped in blocks"
        )
        notes = [*notes, coarse]
    if left_out:
        notes = [*notes, f"{left_out} rows without a time of their own left out"]
    clock, columns = clock[own], {name: column[own] for name, column in columns.items()}
    for name in INPUTS:
        if name in columns and np.isfinite(columns[name]).any():
            columns[name] = _stays(columns[name])
        else:
            columns.pop(name, None)
    steps = np.diff(clock)
    back = steps < 0
    if np.count_nonzero(back) > DISORDER * len(steps):
        raise TwinError(
            f"{source}: time falls back in {np.count_nonzero(back)} of {len(clock)} rows, too often for restarts of a clock: rows sorted by time are needed"
        )
    usual = float(np.median(steps[~back])) if not back.all() else 0.0
    begins = np.flatnonzero(back) + 1
    shift = np.cumsum(np.where(back, steps - usual, 0.0))
    time = clock - clock[0] - np.concatenate([[0.0], shift])
    found = Recording(source, time, columns, tuple(begins.tolist()), notes, coarse)
    _check_units(found)
    return found


def _repeated(clock: Array, columns: Mapping[str, Array], usable: Array) -> int:
    """Number of rows with the time of the row above, but with another reading of an encoder that has a reading in both."""
    same = np.flatnonzero(np.diff(clock[usable]) == 0)
    above, below = usable[same], usable[same + 1]
    differ = np.zeros(len(same), dtype=bool)
    for name in MEASURED:
        if name in columns:
            first, second = columns[name][above], columns[name][below]
            differ |= np.isfinite(first) & np.isfinite(second) & (first != second)
    return int(np.count_nonzero(differ))


def _check_units(given: Recording) -> None:
    """Raises `WrongUnit` for times that look like milliseconds and angles that look like degrees."""
    if unit := units.of_long_step(given.period, SLOW):
        question = units.asks_by_step(given.period, f"less than {SLOW:g} s", units.SHORTER[unit][0])
        raise WrongUnit(given.source, question, TIME, unit)
    for name, column in given.columns.items():
        known = column[np.isfinite(column)]
        if "theta" in name and len(known) and float(np.quantile(np.abs(known), 0.05)) > 2 * np.pi:
            is_counted = bool(np.all(known == np.round(known))) and float(np.max(np.abs(known))) > MOST_DEGREES
            unit, plural = ("counts", "counts of an encoder") if is_counted else ("deg", "degrees")
            raise WrongUnit(
                given.source,
                f"{name} is from {known.min():g} to {known.max():g} rad, beyond a turn nearly always: are these {plural}? "
                "(Whole turns may be left out.)",
                name,
                unit,
            )


def _stays(column: Array) -> Array:
    """Replaces each NaN by the last number before it; leading NaN by the first number."""
    known = np.flatnonzero(np.isfinite(column))
    return np.asarray(column[known[np.maximum(np.searchsorted(known, np.arange(len(column)), side="right") - 1, 0)]])


def _unit(name: str) -> str:
    return next(unit for last, unit in UNITS.items() if name.partition("[")[0].endswith(last))


def _letters(name: str) -> str:
    """Letters and digits of a column's name without a unit in parentheses: alike for `tau[1]` and `tau_1`."""
    return "".join(c for c in name.lower().partition(" (")[0] if c.isalnum())
