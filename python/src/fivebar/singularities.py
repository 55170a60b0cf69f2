"""Singularities that a run passes, found from its communication points.

Three pairs of links can come into line. Each pair has a signal in [-1, 1] that is 0 in line: det J_x over its largest possible
value for the distal links (*direct*), sin(distal - proximal angle) for each leg (*inverse*). An event is a change of sign, or
a stay below `NEAR` without a change of sign. If singular.type is *combined* or *constraint*, or if a direct and an inverse
event lie between the same two points, they form one event of the most severe kind.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fivebar import table
from fivebar.drive import Run

NEAR = 1e-3
"""Share of the largest possible value below which a posture counts as singular (as in the output singular.type)."""

KINDS = ("direct", "inverse", "combined", "constraint")
"""Items of singular.type except "none", in order of severity."""

GRAVE = KINDS[2:]
"""Kinds with more than one pair of links in line."""

PAIRS = ("distal links", "left leg", "right leg")


@dataclass(frozen=True)
class Event:
    """A singularity that the run passes.

    `postures` has one text for each of `PAIRS`: "stretched" (the two links point away from their joint), "folded" (they lie on
    each other) or "" (not involved). `passage` is "crossed" (a sign changed), "touched" (no sign changed) or "start" (the run
    begins in the singularity).
    """

    time: float
    kind: str
    postures: tuple[str, str, str]
    passage: str

    def __str__(self) -> str:
        passage = "at the start" if self.passage == "start" else self.passage
        pairs = ", ".join(f"{pair} {posture}" for pair, posture in zip(PAIRS, self.postures) if posture)
        return f"{self.kind} singularity {passage}: {pairs}"


def find(run: Run) -> list[Event]:
    """All events of a run, sorted by time."""
    signals = _signals(run)
    single = [event for pair in range(len(PAIRS)) for event in _single(signals, pair)]
    events: list[Event] = []
    for window in _windows(run, signals, single):
        begin, end = signals.time[window.before], signals.time[window.after]
        events.append(_grave(signals, window, [e for e in single if begin <= e.time <= end]))
        single = [e for e in single if not begin <= e.time <= end]
    return sorted(events + single, key=lambda event: event.time)


def alignments(run: Run) -> np.ndarray:
    """The signals of `PAIRS` over time, one row per pair: in [-1, 1], and 0 if the two links are in line."""
    return _signals(run).signal


def write(path: Path, events: list[Event]) -> None:
    """Writes the events as CSV; times are in s."""
    table.write(path, ["time", "kind", *PAIRS, "passage"], ([e.time, e.kind, *e.postures, e.passage] for e in events))


def count(events: list[Event]) -> str:
    """Numbers of events, such as "3 direct, 2 inverse (2 left, 0 right), 1 combined, 0 constraint"."""
    left, right = (sum(event.kind == "inverse" and event.postures[pair] != "" for event in events) for pair in (1, 2))
    numbers = [f"{sum(event.kind == kind for event in events)} {kind}" for kind in KINDS]
    numbers[1] += f" ({left} left, {right} right)"
    return ", ".join(numbers)


@dataclass(frozen=True)
class _Signals:
    """One row per pair. `signal` is 0 in line; there `alignment` is positive for stretched and negative for folded links."""

    time: np.ndarray
    signal: np.ndarray
    alignment: np.ndarray

    def at(self, time: float) -> np.ndarray:
        """The three signals at a time, interpolated between samples."""
        return np.array([np.interp(time, self.time, signal) for signal in self.signal])

    def postures(self, time: float, pairs: set[int]) -> tuple[str, str, str]:
        """Whether links of `pairs` are stretched or folded at the sample nearest to `time`."""
        sample = int(np.argmin(np.abs(self.time - time)))
        names = ["stretched" if alignment > 0 else "folded" for alignment in self.alignment[:, sample]]
        distal, left, right = (name if pair in pairs else "" for pair, name in enumerate(names))
        return distal, left, right

    def passage(self, pairs: set[int], window: "_Window") -> str:
        """The passage of `pairs` during a window: "crossed", "touched" or "start"."""
        before, after = (self.signal[sorted(pairs), sample] for sample in (window.before, window.after))
        if np.any((before * after < 0) & (np.abs(before) >= NEAR) & (np.abs(after) >= NEAR)):
            return "crossed"
        return "start" if window.last >= window.first == 0 else "touched"


@dataclass(frozen=True)
class _Window:
    """A stay near a singularity from sample `first` to `last`, the samples before and after it, and the nearest time, s.

    If a crossing lies between two samples and neither is near, `first` is the later and `last` the earlier sample.
    """

    first: int
    last: int
    before: int
    after: int
    kind: str
    time: float

    def joined(self, later: "_Window") -> "_Window":
        """Union of the two windows, with the more severe kind."""
        graver = max(self, later, key=lambda window: KINDS.index(window.kind))
        first, last = min(self.first, later.first), max(self.last, later.last)
        return _Window(first, last, self.before, max(self.after, later.after), graver.kind, graver.time)


def _signals(run: Run) -> _Signals:
    # Distal angles point towards the tip, so opposite directions mean a stretched pair.
    between = run["passive.theta[2]"] - run["passive.theta[1]"]
    bends = [run[f"passive.theta[{leg}]"] - run[f"theta[{leg}]"] for leg in (1, 2)]
    largest = run.parameters["link[2].length"] * run.parameters["link[3].length"]
    return _Signals(
        run.time,
        np.array([run["singular.detJx"] / largest, *np.sin(bends)]),
        np.array([-np.cos(between), *np.cos(bends)]),
    )


def _single(signals: _Signals, pair: int) -> list[Event]:
    """Events of one pair of links."""
    times, signal = signals.time, signals.signal[pair]
    near = np.abs(signal) < NEAR
    jumps = np.flatnonzero((signal[:-1] * signal[1:] < 0) & ~near[:-1] & ~near[1:])
    events = []
    for first, last in sorted(_stays(near) + [(int(i) + 1, int(i)) for i in jumps]):
        # The samples on either side show whether the sign changes during the stay.
        before, after = max(first - 1, 0), min(last + 1, len(signal) - 1)
        nearest = float(times[before + int(np.argmin(np.abs(signal[before : after + 1])))])
        window = _Window(first, last, before, after, KINDS[min(pair, 1)], nearest)
        passage = signals.passage({pair}, window)
        time = _crossing(times, signal, before, after) if passage == "crossed" else nearest
        events.append(Event(time, window.kind, signals.postures(nearest, {pair}), passage))
    return events


def _windows(run: Run, signals: _Signals, single: list[Event]) -> list[_Window]:
    """Windows of combined and constraint singularities, sorted by time and separate from each other."""
    kinds = np.array([run.items["singular.type"][int(value)] for value in run["singular.type"]])
    grave = np.isin(kinds, GRAVE)
    end = len(kinds) - 1
    windows = []
    for first, last in _stays(grave):
        stay = slice(first, last + 1)
        kind = max(kinds[stay], key=KINDS.index)
        # Distance of each sample from the singularity; the samples of the most severe kind decide.
        distance = run["singular.sigmaPhi"][stay] if kind == "constraint" else _apart(signals.signal[:, stay])
        nearest = first + int(np.argmin(np.where(kinds[stay] == kind, distance, np.inf)))
        windows.append(_Window(first, last, max(first - 1, 0), min(last + 1, end), str(kind), float(run.time[nearest])))
    for event in single:
        if event.passage == "crossed" and _apart(signals.at(event.time)) < NEAR:
            i = min(max(int(np.searchsorted(run.time, event.time)) - 1, 0), end - 1)
            windows.append(_Window(i + 1, i, i, i + 1, "combined", event.time))
    separate: list[_Window] = []
    for window in sorted(windows, key=lambda window: window.before):
        if separate and window.before <= separate[-1].after:
            separate[-1] = separate[-1].joined(window)
        else:
            separate.append(window)
    return separate


def _apart(signal: np.ndarray) -> np.ndarray:
    """The larger of both normalised determinants: it is small only in a combined singularity."""
    larger: np.ndarray = np.maximum(np.abs(signal[0]), np.abs(signal[1] * signal[2]))
    return larger


def _grave(signals: _Signals, window: _Window, parts: list[Event]) -> Event:
    """The event of a window; `parts` are the events of single pairs of links in it."""
    pairs = {0, 1, 2}
    if window.kind == "combined":
        pairs = {0} | {pair for part in parts for pair in range(len(PAIRS)) if part.postures[pair]}
        if len(pairs) == 1:
            pairs.add(1 + int(np.argmin(np.abs(signals.at(window.time)[1:]))))
    postures = signals.postures(window.time, pairs)
    return Event(window.time, window.kind, postures, signals.passage(pairs, window))


def _stays(near: np.ndarray) -> list[tuple[int, int]]:
    """Index ranges (first, last) of consecutive `near` samples."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], near, [False])).astype(np.int8)))
    return [(int(first), int(end) - 1) for first, end in edges.reshape(-1, 2)]


def _crossing(times: np.ndarray, signal: np.ndarray, before: int, after: int) -> float:
    """Interpolated time of the first change of sign between two samples."""
    sign = np.sign(signal[before])
    beyond = before + 1 + int(np.argmax(np.sign(signal[before + 1 : after + 1]) != sign))
    a, b = signal[beyond - 1], signal[beyond]
    return float(times[beyond - 1] + (times[beyond] - times[beyond - 1]) * a / (a - b))
