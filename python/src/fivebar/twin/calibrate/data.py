"""Measured series: encoder angles and drive commands, from a record of the twin, or from a table (CSV or Parquet)."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from fivebar.errors import warn
from fivebar.library import Library
from fivebar.plain import plain
from fivebar.scene_file import OFFSETS
from fivebar.twin import record, recording, turn
from fivebar.twin.errors import Refused, TwinError
from fivebar.twin.messages import INPUTS, MEAS_FIELDS, MEASURED, decode
from fivebar.twin.recording import FEWEST, Array
from fivebar.variables import Value

GAP: Final = 5.5
"""Longest gap within a series, in its median sampling periods; in a longer gap the drive commands are unknown."""

MANY_LEFT_OUT: Final = 0.1
"""Share of the samples; a record with a few gaps leaves out less."""

FIRST: Final = 5
"""Number of samples for the initial turn of an encoder: the median, because one may be an outlier."""

SHORTEST: Final = 1.0
"""Minimum total duration of the series, s."""

MOVES: Final = 0.05
"""Minimum motion of servo commands that counts as motion, rad."""

EARLIER: Final = 0.1
"""Time before a part of a series whose commands may act in it, s: the bound of `servo.delay`."""


@dataclass(frozen=True)
class Samples:
    """A series: times in s from its first sample, rising; angles in rad, NaN if an encoder has no sample; drive commands."""

    time: Array
    """(n)."""

    angles: Array
    """(n, 2)."""

    commands: Array
    """(n, m), no NaN: a command stays until the next one."""

    names: tuple[str, ...]
    """Names of the m inputs of the unit."""

    earlier: "Samples | None" = None
    """The samples of the last `EARLIER` s before a part of a series."""

    period: float = 0.0
    """Median sampling period of the recording's series, s; 0 if unknown."""

    def __len__(self) -> int:
        return len(self.time)

    def part(self, first: int, last: int) -> "Samples":
        """Samples first to last - 1; times stay."""
        earlier = self.earlier
        if 0 < first < len(self):
            begin = max(0, int(np.searchsorted(self.time, self.time[first] - EARLIER, side="right")) - 1)
            earlier = self._rows(begin, first, None if begin else earlier)
        return replace(self._rows(first, last), earlier=earlier)

    def _rows(self, first: int, last: int, before: "Samples | None" = None) -> "Samples":
        """Samples first to last - 1, preceded by the samples `before`."""
        rows = [self.time[first:last], self.angles[first:last], self.commands[first:last]]
        if before is not None:
            own = (before.time, before.angles, before.commands)
            rows = [np.concatenate(pair) for pair in zip(own, rows, strict=True)]
        time, angles, commands = rows
        return Samples(time, angles, commands, self.names, period=self.period)


@dataclass(frozen=True)
class Data:
    """Series without gaps, and notes about their preparation."""

    series: list[Samples]
    notes: list[str]
    source: str | Path = recording.GIVEN
    """File or folder, for error messages."""

    left_out: str = ""
    """A sentence if more than `MANY_LEFT_OUT` of the samples are left out, else ""."""

    coarse: str = ""
    """The note about coarse times, of which `read` warns, else ""."""

    @property
    def period(self) -> float:
        """Median sampling period, s."""
        return float(np.median(np.concatenate([np.diff(s.time) for s in self.series])))


def read(source: Any, begin: float, seconds: float, unit: str = "") -> Data:
    """The samples of a record, a table or columns, from `begin` s after the first one on, at most `seconds` of them."""
    if not isinstance(source, Path):
        given = recording.of_columns(source)
    else:
        given = of_record(source, unit) if source.is_dir() or record.is_of_twin(source) else recording.read(source)
    first, last = np.searchsorted(given.time, begin), np.searchsorted(given.time, begin + seconds, side="right")
    if first == last:
        raise TwinError(
            f"{given.source} has no sample between {begin:g} s and {begin + seconds:g} s; "
            f"its last sample is at {given.time[-1]:.3f} s"
        )
    data = split(given.part(int(first), int(last)))
    if data.left_out:
        warn(data.left_out)
    if given.coarse:
        warn(f"{given.source}: {given.coarse}")
    if last - first < len(given.time):
        length = f"{seconds:g} s" if math.isfinite(seconds) else "all"
        data.notes.append(f"used are {last - first} of {len(given.time)} samples: {length} from {begin:g} s on")
    return data


def check(data: Data) -> None:
    """Raises `TwinError` for data that do not allow a calibration: too short, without an encoder, at rest despite commands, or with swapped encoders."""
    span = sum(float(series.time[-1] - series.time[0]) for series in data.series)
    if span < SHORTEST:
        raise TwinError(f"the record has {span:.3g} s; {SHORTEST:g} s or more are needed")
    angles = np.concatenate([series.angles for series in data.series])
    for name, column in zip(MEASURED, angles.T, strict=True):
        if not np.isfinite(column).any():
            more = "".join(f"; {note}" for note in data.notes)
            raise TwinError(f"{data.source} has no number in {name}; both encoders are needed{more}")
    names = data.series[0].names
    servos = [f"servo.theta[{i}]" for i in (1, 2)]
    if not all(name in names for name in servos):
        return
    commanded = np.concatenate([series.commands[:, [names.index(name) for name in servos]] for series in data.series])
    # Without 1 % on either side, because outliers look like motion of a resting machine.
    moved, led = (np.diff(np.nanquantile(each, (0.01, 0.99), axis=0), axis=0)[0] for each in (angles, commanded))
    if float(led.max()) > MOVES and np.all(~(moved > 0.02 * led.max())):
        raise TwinError(
            f"the measured angles stand still (they move by {plain(1e3 * float(np.nan_to_num(moved).max()))} mrad) while servo commands move "
            f"by {plain(1e3 * float(led.max()))} mrad: are the drives off, or is this another machine's record?"
        )

    def apart(columns: list[int]) -> float:
        gap = angles - commanded[:, columns]
        return float(np.sqrt(np.nanmean((gap - 2 * math.pi * np.round(gap / (2 * math.pi))) ** 2)))

    if apart([1, 0]) < 0.3 * apart([0, 1]):
        raise TwinError(
            f"measured.theta[1] follows servo.theta[2] and the other way round (rms {apart([1, 0]):.3g} rad instead of {apart([0, 1]):.3g} rad): "
            "are the encoders swapped?"
        )


def unled(data: Data, values: Mapping[str, Value]) -> str:
    """A sentence about torques in the record while servos without recorded commands are on; "" without a doubt. `values`: all start values of the machine."""
    names = data.series[0].names
    if not values["servo.enabled"]:
        return ""
    torques = [
        f"tau[{i}]"
        for i in (1, 2)
        if (float(values[f"servo.kp[{i}]"]) > 0 or float(values[f"servo.kd[{i}]"]) > 0)
        and f"tau[{i}]" in names
        and not any(f"{servo}[{i}]" in names for servo in ("servo.theta", "servo.omega"))
        and any(np.any(series.commands[:, names.index(f"tau[{i}]")]) for series in data.series)
    ]
    if not torques:
        return ""
    needed = " and ".join(name.replace("tau", "servo.theta") for name in torques)
    return (
        f"the scene's servos are on, but the record has {' and '.join(torques)} and no {needed}: these servos are taken to hold a constant angle; "
        "set servo.enabled to false if tau is the whole torque"
    )


def split(given: recording.Recording) -> Data:
    """Splits a recording at gaps and restarts of the clock; series of less than `FEWEST` samples are left out."""
    time, table = given.time, given.columns
    names = tuple(name for name in INPUTS if name in table)
    angles = np.column_stack([table.get(name, np.full(len(time), np.nan)) for name in MEASURED])
    commands = np.column_stack([table[name] for name in names]) if names else np.empty((len(time), 0))
    periods = given.periods
    gaps = np.flatnonzero(np.diff(time) > GAP * periods[1:]) + 1
    samples = Samples(time, angles, commands, names)
    parts = [
        replace(samples.part(a, b), period=float(periods[a]))
        for a, b in pairwise((0, *sorted({*gaps.tolist(), *given.begins}), len(time)))
    ]
    counts = [int(np.isfinite(part.angles).any(axis=1).sum()) for part in parts]
    series = [part for part, count in zip(parts, counts, strict=True) if count >= FEWEST]
    if not series:
        back = f"; its clock falls back {len(given.begins)} times" if given.begins else ""
        raise TwinError(f"{given.source} has no series of {FEWEST} samples or more without a gap{back}")
    lacking = sum(count for count in counts if count < FEWEST)
    left_out = (
        f"{given.source}: {lacking} of {sum(counts)} samples are left out, because there are fewer than {FEWEST} between two gaps or jumps of the clock; "
        "a part with another rate must be a file of its own"
        if lacking > MANY_LEFT_OUT * sum(counts)
        else ""
    )
    notes = list(given.notes)
    if len(parts) > 1:
        notes.append(
            f"{len(parts) - 1} gaps or jumps of the clock; {len(parts) - len(series)} series of less than {FEWEST} samples are left out"
        )
    return Data(series, notes, given.source, left_out, given.coarse)


def turned(given: Data, library: Library, scene: Mapping[str, Value]) -> Data:
    """Unwraps the encoders of each series, and moves it into the turn in which a twin would start."""
    offsets = [float(scene.get(name, 0.0)) for name in OFFSETS]
    series, notes = [], dict.fromkeys(given.notes)
    for samples in given.series:
        angles = np.column_stack([_unwrapped(column) for column in samples.angles.T])
        commands = dict(zip(samples.names, samples.commands[0].tolist(), strict=True))
        for i, offset in enumerate(offsets, 1):
            if f"servo.theta[{i}]" in commands:
                commands[f"servo.theta[{i}]"] -= offset
        first = [
            _middle(column[np.isfinite(column)][:FIRST]) - offset
            for column, offset in zip(angles.T, offsets, strict=True)
        ]
        begins = turn.begins(library, scene, commands, first)
        series.append(replace(samples, angles=angles + turn.TURN * np.array([begin.turns for begin in begins])))
        notes |= dict.fromkeys(begin.sentence for begin in begins if begin.turns)
    return replace(given, series=series, notes=list(notes))


def _unwrapped(column: Array) -> Array:
    """Angles of an encoder without jumps by whole turns, rad. The reference is the median of the three previous angles, because one may be an outlier."""
    found = column.copy()
    before: list[float] = []
    for k in np.flatnonzero(np.isfinite(column)):
        if before:
            found[k] += turn.TURN * round((_middle(before) - found[k]) / turn.TURN)
        before = [*before[-2:], float(found[k])]
    return found


def _middle(angles: Array | list[float]) -> float:
    """Median; NaN without angles."""
    return float(np.median(angles)) if len(angles) else math.nan


def of_record(file: Path, unit: str) -> recording.Recording:
    """The samples of a record of `fivebar twin`."""
    return of_messages(file, ((row.topic, row.payload) for row in record.rows(file)), unit)


def of_messages(source: str | Path, received: Iterable[tuple[str, bytes]], unit: str) -> recording.Recording:
    """The samples among messages (topic and payload), in the order of their numbers. Repeated samples are used once; invalid ones are counted."""
    found: dict[int, tuple[int, dict[str, float]]] = {}
    refused = doubled = restarts = 0
    units: set[str] = set()
    base, highest = 0, -1
    reason = ""
    for topic, payload in received:
        of, _, kind = topic.removeprefix("fivebar/").partition("/")
        if kind != "meas" or (unit and of != unit):
            continue
        try:
            message = decode(topic, payload)
        except Refused as error:
            refused, reason = refused + 1, reason or str(error)
            continue
        units.add(of)
        if message.seq < highest - 1000:
            # The machine restarted its count: append later samples after all earlier ones.
            base, highest, restarts = max(found) + 1000, -1, restarts + 1
        highest = max(highest, message.seq)
        if base + message.seq in found:
            doubled += 1
        else:
            found[base + message.seq] = message.time, message.fields
    if len(units) > 1:
        raise TwinError(f"{source} has samples of {', '.join(sorted(units))}: choose one by --unit")
    if not found:
        why = f"; {refused} are malformed: {reason}" if refused else ""
        raise TwinError(f"{source} has no message meas" + (f" of unit {unit!r}" if unit else "") + why)
    numbers = sorted(found)
    time = 1e-9 * np.array([found[number][0] - found[numbers[0]][0] for number in numbers])
    rows = [found[number][1] for number in numbers]
    table = {name: np.array([row.get(name, np.nan) for row in rows]) for name in MEAS_FIELDS}
    notes = [
        f"{count} {what}"
        for count, what in (
            (refused, f"malformed messages left out, the first one because {reason}"),
            (doubled, "doubled samples"),
            (restarts, "restarts of the machine"),
        )
        if count
    ]
    return recording.of(source, time, table, notes)
