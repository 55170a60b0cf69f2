"""Makes a recording from file columns and a map: units, signs and offsets, and common rows for columns with different clocks."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from fivebar import table
from fivebar.errors import FiveBarError
from fivebar.twin import recording
from fivebar.twin.importing import sources
from fivebar.twin.importing.maps import PASSIVE, VARIABLES, Entry, Map
from fivebar.twin.importing.sources import MissingColumn, Stream
from fivebar.twin.messages import INPUTS, MEASURED
from fivebar.twin.recording import TIME, Array, Recording

TOGETHER: Final = 0.25
"""Samples of two encoders become one row if they are closer than this share of the median step; closer rows would change the median step of the recording."""


def recorded(files: Sequence[Path], given: Map) -> tuple[Recording, Map]:
    """Reads a recording from files, each with one or more series; returns it and the map that was used. Raises FiveBarError.

    Without a map, files may name different variables: the map has those of all files, with the columns of the first file that has them.
    """
    clocks, tables, notes, used, last = [], [], [], given, 0.0
    for file in files:
        try:
            of_file = given if given.entries else named(file, given)
            clock, columns, own = _rows(file, of_file)
        except MissingColumn as error:
            if len(files) == 1:
                raise
            raise FiveBarError(
                f"{error}; several files are series with the same columns: commands in a file of their own must first be joined with the encoders by time"
            ) from None
        known = clock[np.isfinite(clock)]
        if not len(known):
            raise FiveBarError(f"{file} has no row with a time")
        # A clock that goes back marks the begin of a series.
        clocks.append(clock - known[0] + last - 1.0)
        last = clocks[-1][np.isfinite(clock)][-1]
        tables.append(columns)
        notes += own
        notes += [
            f"{file} has {name} in the column {entry.column}"
            for name, entry in of_file.entries.items()
            if used.entries.get(name, entry) != entry
        ]
        used = used.exchanged({name: entry for name, entry in of_file.entries.items() if name not in used.entries})
    names = [name for name in VARIABLES if any(name in columns for columns in tables)]
    joined = {
        name: np.concatenate(
            [columns.get(name, np.full(len(clock), np.nan)) for clock, columns in zip(clocks, tables, strict=True)]
        )
        for name in names
    }
    for file, columns in zip(files, tables, strict=True):
        if missing := [name for name in names if name not in columns]:
            notes.append(f"{file} has no column for {' and '.join(missing)}")
    source = " and ".join(str(file) for file in files)
    if not any(np.isfinite(joined[name]).any() for name in MEASURED if name in joined):
        raise FiveBarError(f"{source} has no number in the column of {MEASURED[0]} or {MEASURED[1]}")
    return recording.of(source, np.concatenate(clocks), joined, list(dict.fromkeys(notes))), used


def write(given: Recording, file: Path) -> None:
    """Writes the table for calibration, validation and twin; the clock of each series starts at 0."""
    begins = np.array([0, *given.begins])
    first = begins[np.searchsorted(begins, np.arange(len(given.time)), side="right") - 1]
    table.write_columns(file, {TIME: given.time - given.time[first], **given.columns})


def named(file: Path, given: Map) -> Map:
    """The map of a table in which columns are named as the variables."""
    columns = sources.names(file, given.time.column)
    others = {name.removeprefix("measured."): name for name in MEASURED}
    found = {others.get(name, name): Entry(name) for name in columns if name in VARIABLES or name in others}
    found |= {name: Entry(name) for name in MEASURED if name in columns}
    if not any(name in found for name in MEASURED):
        raise MissingColumn(
            f"{file} has no column {MEASURED[0]} or {MEASURED[1]}; without --map these names are needed, and its columns are {sources.listed(columns)}"
        )
    return given.exchanged(found)


def _rows(file: Path, given: Map) -> tuple[Array, dict[str, Array], list[str]]:
    """Reads clock in s, variables and notes from a file."""
    streams = sources.read(file, {entry.column: None for entry in given.entries.values()}, given.time.column)
    head = next((stream.units[given.time.column] for stream in streams if given.time.column in stream.units), "")
    if any(stream.is_dated for stream in streams) and given.time.unit not in ("", head):
        raise FiveBarError(
            f"'{TIME}.unit' is '{given.time.unit}', but {given.time.column:.60} has dates, which need no unit"
        )
    factor = given.time.factor(TIME, head)
    if len(streams) == 1:
        clock = factor * streams[0].clock
        raw = {name: streams[0].columns[entry.column] for name, entry in given.entries.items()}
        notes: list[str] = []
    else:
        clock, raw, notes = _together(file, streams, given)
    columns = {
        name: entry.factor(name, next((s.units[entry.column] for s in streams if entry.column in s.units), ""))
        * raw[name]
        + entry.offset
        for name, entry in given.entries.items()
    }
    for passive, proximal in zip(PASSIVE, MEASURED, strict=True):
        if passive in columns and given.entries[passive].relative:
            columns[passive] = columns[passive] + columns[proximal]
    return clock, columns, notes


def _together(file: Path, streams: list[Stream], given: Map) -> tuple[Array, dict[str, Array], list[str]]:
    """Merges streams with different clocks: encoder samples keep their times, and commands hold until the next one."""
    for stream in streams:
        if np.any(back := np.diff(stream.clock) < 0):
            raise FiveBarError(
                f"{file}: {stream.name} falls back at {stream.clock[np.argmax(back)]:.3f} s, so several topics cannot be combined; "
                f'a map with "{TIME}": {{"column": "{sources.RECEIVED}"}} takes the recorder\'s clock'
            )
    by_name = {name: next(s for s in streams if entry.column in s.columns) for name, entry in given.entries.items()}
    main, *others = sorted((by_name[name] for name in MEASURED if name in by_name), key=lambda s: -len(s.clock))
    rows, period = main.clock, float(np.median(np.diff(main.clock))) if len(main.clock) > 1 else 0.0
    for stream in others:
        apart = np.abs(stream.clock - rows[_nearest(rows, stream.clock)])
        rows = np.union1d(rows, stream.clock[apart > TOGETHER * period])
    columns, notes = {}, []
    for name, stream in by_name.items():
        place = _holding if name in INPUTS else _placed
        columns[name], note = place(rows, stream.clock, stream.columns[given.entries[name].column], 0.5 * period)
        if stream is not main:
            notes.append(f"{name} is from {stream.name}, {len(stream.clock)} values: {note}")
    return rows, columns, notes


def _holding(rows: Array, times: Array, values: Array, most: float) -> tuple[Array, str]:
    """Fills rows with values that hold until the next one; returns them and a note."""
    before = np.searchsorted(times, rows, side="right") - 1
    after = np.searchsorted(rows, times)
    late = rows[after[after < len(rows)]] - times[after < len(rows)]
    return (
        np.where(before >= 0, values[before], np.nan),
        f"each holds until the next one, starting at the next encoder sample, up to {1e3 * late.max(initial=0.0):.3g} ms later",
    )


def _placed(rows: Array, times: Array, values: Array, most: float) -> tuple[Array, str]:
    """Puts each value into the nearest row, at most `most` s away; returns them and a note."""
    nearest = _nearest(rows, times)
    apart = np.abs(rows[nearest] - times)
    near = apart <= most
    column = np.full(len(rows), np.nan)
    column[nearest[near]] = values[near]
    lost = len(values) - len(np.unique(nearest[near]))
    left = f"; {lost} have no row of their own and are left out" if lost else ""
    return column, f"each is in the nearest row, up to {1e3 * apart[near].max(initial=0.0):.3g} ms away{left}"


def _nearest(rows: Array, times: Array) -> Array:
    """Index of the row nearest to each time."""
    after = np.minimum(np.searchsorted(rows, times), len(rows) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(rows[after] - times) < np.abs(rows[before] - times), after, before)
