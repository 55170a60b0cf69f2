"""Measured series: angles of the encoders and commands of the drives, from a record (Parquet) or a table (CSV)."""

import math
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv

from fivebar.twin import record
from fivebar.twin.errors import Refused, TwinError
from fivebar.twin.messages import INPUTS, MEASURED, decode

LARGEST_CSV: Final = 1_000_000_000
"""Bytes of a table that is read at most."""

GAP: Final = 5.5
"""Usual distances of two samples after which a series ends: commands of the drives in a longer gap are not known."""

SLOW: Final = 0.5
"""s a sample: nothing that moves is sampled as slowly to be calibrated, but ms that are taken for s look so."""

SHORTEST: Final = 1.0
"""s of all series together."""

MOVES: Final = 0.05
"""rad: servos that are led by more are told to move."""

Array = np.ndarray


@dataclass(frozen=True)
class Samples:
    """A series: times in s from its first sample, rising; angles in rad, NaN where an encoder has no sample; commands of the drives."""

    time: Array
    """(n)."""

    angles: Array
    """(n, 2)."""

    commands: Array
    """(n, m), no NaN: a command stays until the next one."""

    names: tuple[str, ...]
    """The m inputs of the unit."""

    def __len__(self) -> int:
        return len(self.time)

    def part(self, first: int, last: int) -> "Samples":
        """Samples first to last - 1; times stay."""
        return replace(
            self, time=self.time[first:last], angles=self.angles[first:last], commands=self.commands[first:last]
        )


@dataclass(frozen=True)
class Data:
    """Series without gaps, and notes on how they were made."""

    series: list[Samples]
    notes: list[str]

    @property
    def period(self) -> float:
        """The usual distance of two samples, s."""
        return float(np.median(np.concatenate([np.diff(s.time) for s in self.series])))


def read(file: Path, begin: float, seconds: float, unit: str = "") -> Data:
    """The samples of a record or a table, from `begin` s after the first one on, at most `seconds` of them."""
    if file.is_file() and file.suffix.lower() == ".csv":
        time, table, notes = _csv(file)
    else:
        time, table, notes = _record(file, unit)
    check_units(file, time, table)
    chosen = (time >= begin) & (time <= begin + seconds)
    if not chosen.any():
        raise TwinError(
            f"{file} has no sample from {begin:g} s on for {seconds:g} s; its last one is at {time[-1]:.3f} s"
        )
    if chosen.sum() < len(time):
        notes.append(f"used are {chosen.sum()} of {len(time)} samples: {seconds:g} s from {begin:g} s on")
    data = split(time[chosen], {name: column[chosen] for name, column in table.items()}, notes)
    if not data.series:
        raise TwinError(f"{file} has no series of 20 samples or more without a gap")
    return data


def check_units(file: Path, time: Array, table: dict[str, Array]) -> None:
    """Refuses times that look like milliseconds and angles that look like degrees."""
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    if step >= SLOW:
        what = "milliseconds" if step < 1e3 * SLOW else "microseconds or nanoseconds"
        raise TwinError(
            f"{file}: time goes on by {step:g} s a sample (median); less than {SLOW:g} s is expected: are these {what}?"
        )
    for name, column in table.items():
        known = np.abs(column[np.isfinite(column)])
        if "theta" in name and len(known) and float(np.quantile(known, 0.05)) > 2 * math.pi:
            raise TwinError(
                f"{file}: {name} is from {np.nanmin(column):g} to {np.nanmax(column):g} rad, beyond a turn nearly always: are these degrees? "
                "(Whole turns may be left out.)"
            )


def check(data: Data) -> None:
    """Refuses data from which no machine can be found: too short, at rest though it is told to move, with its encoders in the places of each other."""
    span = sum(float(series.time[-1] - series.time[0]) for series in data.series)
    if span < SHORTEST:
        raise TwinError(f"the record has {span:.3g} s; {SHORTEST:g} s or more are needed")
    names = data.series[0].names
    servos = [f"servo.theta[{i}]" for i in (1, 2)]
    if not all(name in names for name in servos):
        return
    angles = np.concatenate([series.angles for series in data.series])
    told = np.concatenate([series.commands[:, [names.index(name) for name in servos]] for series in data.series])
    # Less one of a hundred on either side: outliers move, also where the machine does not.
    moved, led = (np.diff(np.nanquantile(each, (0.01, 0.99), axis=0), axis=0)[0] for each in (angles, told))
    if float(led.max()) > MOVES and np.all(~(moved > 0.02 * led.max())):
        raise TwinError(
            f"the measured angles stand still (they move by {1e3 * float(np.nan_to_num(moved).max()):.3g} mrad) while servos are told to move "
            f"by {1e3 * float(led.max()):.3g} mrad: are the drives off, or is this another machine's record?"
        )

    def apart(columns: list[int]) -> float:
        gap = angles - told[:, columns]
        return float(np.sqrt(np.nanmean((gap - 2 * math.pi * np.round(gap / (2 * math.pi))) ** 2)))

    if apart([1, 0]) < 0.3 * apart([0, 1]):
        raise TwinError(
            f"measured.theta[1] follows servo.theta[2] and the other way round (rms {apart([1, 0]):.3g} rad instead of {apart([0, 1]):.3g} rad): "
            "are the encoders swapped?"
        )


def split(time: Array, table: dict[str, Array], notes: list[str]) -> Data:
    """Series between gaps; those of less than 20 samples are left out."""
    names = tuple(name for name in INPUTS if name in table and np.isfinite(table[name]).any())
    angles = np.column_stack([table.get(name, np.full(len(time), np.nan)) for name in MEASURED])
    commands = np.column_stack([_stays(table[name]) for name in names]) if names else np.empty((len(time), 0))
    samples = Samples(time, angles, commands, names)
    steps = np.diff(time)
    ends = np.flatnonzero((steps > GAP * np.median(steps)) | (steps <= 0)) + 1 if len(steps) else np.empty(0, int)
    parts = [samples.part(a, b) for a, b in zip([0, *ends], [*ends, len(time)], strict=True)]
    series = [part for part in parts if np.isfinite(part.angles).any(axis=1).sum() >= 20]
    if len(parts) > 1:
        notes.append(
            f"{len(parts) - 1} gaps or jumps of the clock; {len(parts) - len(series)} series of less than 20 samples are left out"
        )
    return Data(series, notes)


def _stays(column: Array) -> Array:
    """Column with each NaN replaced by the last number before it, or by the first number of all."""
    known = np.flatnonzero(np.isfinite(column))
    return column[known[np.maximum(np.searchsorted(known, np.arange(len(column)), side="right") - 1, 0)]]


def _record(file: Path, unit: str) -> tuple[Array, dict[str, Array], list[str]]:
    """Samples in the order of their count; a repeated sample counts once, rows that are no messages are counted."""
    found: dict[int, tuple[int, dict[str, float]]] = {}
    refused = doubled = restarts = 0
    units: set[str] = set()
    base, highest = 0, -1
    for row in record.rows(file):
        of, _, kind = row.topic.removeprefix("fivebar/").partition("/")
        if kind != "meas" or (unit and of != unit):
            continue
        try:
            message = decode(row.topic, row.payload)
        except Refused:
            refused += 1
            continue
        units.add(of)
        if message.seq < highest - 1000:
            # The machine counts anew: later samples are put after all earlier ones.
            base, highest, restarts = max(found) + 1000, -1, restarts + 1
        highest = max(highest, message.seq)
        if base + message.seq in found:
            doubled += 1
        else:
            found[base + message.seq] = message.time, message.fields
    if len(units) > 1:
        raise TwinError(f"{file} has samples of {', '.join(sorted(units))}: say which by --unit")
    if not found:
        raise TwinError(f"{file} has no message meas" + (f" of unit {unit!r}" if unit else ""))
    numbers = sorted(found)
    time = 1e-9 * np.array([found[number][0] - found[numbers[0]][0] for number in numbers])
    rows = [found[number][1] for number in numbers]
    table = {name: np.array([row.get(name, np.nan) for row in rows]) for name in (*MEASURED, *INPUTS)}
    notes = [
        f"{count} {what}"
        for count, what in (
            (refused, "malformed messages left out"),
            (doubled, "doubled samples"),
            (restarts, "restarts of the machine"),
        )
        if count
    ]
    return time, table, notes


def _times(column: "pa.ChunkedArray[Any]") -> Array:
    """Times from the first one on, s, subtracted as the decimals of the text: behind 1e9 s floats have steps of 0.1 us."""
    times = [Decimal((text or "").strip() or "nan") for text in column.to_pylist()]
    first = min((time for time in times if time.is_finite()), default=Decimal(0))
    return np.array([float(time - first) for time in times])


def _csv(file: Path) -> tuple[Array, dict[str, Array], list[str]]:
    """A table with the columns `time` in s, measured.theta[1], measured.theta[2] (or theta[1], theta[2]) and inputs of the unit."""
    if file.stat().st_size > LARGEST_CSV:
        raise TwinError(f"{file} has more than {LARGEST_CSV} bytes")
    try:
        read_ = pa.csv.read_csv(file, convert_options=pa.csv.ConvertOptions(column_types={"time": pa.string()}))
        if twice := [name for name in read_.column_names if read_.column_names.count(name) > 1]:
            raise TwinError(
                f"{file} has {read_.column_names.count(twice[0])} columns {twice[0]}; each name may stand in the head once"
            )
        columns = {
            name.strip(): _times(column) if name == "time" else column.cast(pa.float64()).to_numpy()
            for name, column in zip(read_.column_names, read_.columns, strict=True)
        }
    except InvalidOperation:
        raise TwinError(f"{file} has a time that is no number; times in s are expected") from None
    except (pa.ArrowException, OSError) as error:
        raise TwinError(f"{file} is not a table of numbers with a head: {str(error)[:120]}") from None
    if "time" not in columns:
        raise TwinError(f"{file} has no column time (s); it has {', '.join(columns)[:200]}")
    for name in MEASURED:
        columns.setdefault(name, columns.get(name.removeprefix("measured."), np.full(len(columns["time"]), np.nan)))
    if not any(np.isfinite(columns[name]).any() for name in MEASURED):
        raise TwinError(f"{file} has neither {MEASURED[0]} nor {MEASURED[1]}")
    usable = np.isfinite(columns["time"])
    order = np.flatnonzero(usable)[np.argsort(columns["time"][usable], kind="stable")]
    time = columns["time"][order]
    first = np.concatenate([[True], np.diff(time) > 0])
    notes = (
        [f"{len(usable) - first.sum()} rows without a time of their own left out"] if first.sum() < len(usable) else []
    )
    kept = order[first]
    return time[first], {name: columns[name][kept] for name in (*MEASURED, *INPUTS) if name in columns}, notes
