"""Singularities that a run met, found in its samples.

Each kind has a signal in [-1, 1] that is 0 in the singularity: det J_x over its largest possible value for *direct* (distal
links in line), sin(distal - proximal angle) of each leg for *inverse* (leg in line). An event is a change of sign, or a
stay below `NEAR` that does not change the sign.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drive import Run

NEAR = 1e-3
"""Share of the largest possible value below which a posture counts as singular (as for the output singular.type)."""


@dataclass(frozen=True)
class Event:
    """A singularity met: `kind` direct or inverse, `leg` left, right or "" for direct."""

    time: float
    kind: str
    leg: str
    posture: str  # "stretched": the two links point away from their joint; "folded": they lie on each other
    passage: str  # "crossed": the sign changed; "touched": it did not; "start": the run begins there

    def __str__(self) -> str:
        links = f"{self.leg} leg" if self.leg else "distal links"
        passage = "at the start" if self.passage == "start" else self.passage
        return f"{self.kind} singularity {passage}: {links} {self.posture}"


def find(run: Run) -> list[Event]:
    """All events of a run, in the order of time."""
    between = run["passive.theta[2]"] - run["passive.theta[1]"]
    largest = run.parameters["link[2].length"] * run.parameters["link[3].length"]
    # Both distal angles are measured towards the tip: opposite directions mean a stretched pair.
    events = _events(run.time, run["singular.detJx"] / largest, -np.cos(between), "direct", "")
    for number, leg in ((1, "left"), (2, "right")):
        bend = run[f"passive.theta[{number}]"] - run[f"theta[{number}]"]
        events += _events(run.time, np.sin(bend), np.cos(bend), "inverse", leg)
    return sorted(events, key=lambda event: event.time)


def write(path: Path, events: list[Event]) -> None:
    """Writes the events as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time [s]", "kind", "leg", "posture", "passage"])
        writer.writerows([repr(e.time), e.kind, e.leg, e.posture, e.passage] for e in events)


def count(events: list[Event]) -> str:
    """Such as "3 direct, 2 inverse (2 left, 0 right)"."""
    direct = sum(event.kind == "direct" for event in events)
    left = sum(event.leg == "left" for event in events)
    right = sum(event.leg == "right" for event in events)
    return f"{direct} direct, {left + right} inverse ({left} left, {right} right)"


def _events(times: np.ndarray, signal: np.ndarray, alignment: np.ndarray, kind: str, leg: str) -> list[Event]:
    """Events of one signal; `alignment` is positive where the links are stretched, negative where they are folded."""
    events = []
    for first, last in _stays(signal):
        # One sample on either side shows whether the sign changes during the stay.
        before, after = max(first - 1, 0), min(last + 1, len(signal) - 1)
        crossed = signal[before] * signal[after] < 0 and abs(signal[before]) >= NEAR and abs(signal[after]) >= NEAR
        nearest = before + int(np.argmin(np.abs(signal[before : after + 1])))
        time = _crossing(times, signal, before, after) if crossed else float(times[nearest])
        posture = "stretched" if alignment[nearest] > 0 else "folded"
        passage = "crossed" if crossed else "start" if last >= first == 0 else "touched"
        events.append(Event(time, kind, leg, posture, passage))
    return events


def _stays(signal: np.ndarray) -> list[tuple[int, int]]:
    """Index ranges (first, last) of samples below `NEAR`; a jump across without such a sample is (i + 1, i)."""
    near = np.abs(signal) < NEAR
    edges = np.flatnonzero(np.diff(np.concatenate(([False], near, [False])).astype(np.int8)))
    stays = [(int(first), int(end) - 1) for first, end in edges.reshape(-1, 2)]
    jumps = np.flatnonzero((signal[:-1] * signal[1:] < 0) & ~near[:-1] & ~near[1:])
    return sorted(stays + [(int(i) + 1, int(i)) for i in jumps])


def _crossing(times: np.ndarray, signal: np.ndarray, before: int, after: int) -> float:
    """Time of the first change of sign between two samples, interpolated."""
    sign = np.sign(signal[before])
    beyond = before + 1 + int(np.argmax(np.sign(signal[before + 1 : after + 1]) != sign))
    a, b = signal[beyond - 1], signal[beyond]
    return float(times[beyond - 1] + (times[beyond] - times[beyond - 1]) * a / (a - b))
