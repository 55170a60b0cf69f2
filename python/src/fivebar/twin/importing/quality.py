"""Quality of an encoder's samples: rate, jitter, lost samples, resolution and noise; how fast commands change; and the lines for a scene that
configure the estimator."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from fivebar.plain import plain
from fivebar.twin.messages import MEASURED, SERVOS, TORQUES
from fivebar.twin.recording import FEWEST as SERIES
from fivebar.twin.recording import Array, Recording, distinct

WINDOW: Final = 50
"""Number of samples in a window; each window gives one estimate of the noise from third differences."""

THIRD: Final = 20.0
"""Variance of the third differences of white noise with variance 1: 1 + 9 + 9 + 1."""

FEWEST: Final = 8
"""Minimum number of differences to identify the resolution; fewer may be multiples of a step by chance."""

EVEN: Final = 0.2
"""Deviation from the median step up to which samples are even, relative to the step."""

STILL: Final = 20
"""Minimum number of equal readings of an encoder that stands still."""

LOST: Final = 1.5
"""A longer distance than this number of median steps means a missing sample."""


WITHIN: Final = 0.1
"""Time within which the changes of a command are measured, s: the time that `estimator.commandScale` refers to."""

SCALES: Final = {
    **{name: (f"estimator.commandScale.tau{name[-3:]}", "N.m") for name in TORQUES},
    **{name: (f"estimator.commandScale.theta{name[-3:]}", "rad") for name in SERVOS},
}
"""Parameter of the unit for the changes of each command, with its unit."""


class Gap(NamedTuple):
    """A gap with lost samples."""

    begin: float
    """s."""

    length: float
    """s."""

    steps: float
    """Length in median steps of the series."""


@dataclass(frozen=True)
class Quality:
    """Quality figures of an encoder."""

    name: str
    samples: int
    periods: tuple[float, ...]
    """Median distances between samples, s: one for each rate of the series, rising; none for a single sample."""

    jitter: float
    """Standard deviation of the distance from the median of the series, without lost samples, s."""

    uneven: float
    """The same, relative to the median of the series."""

    lost: int
    gaps: tuple[Gap, ...]
    """All gaps with lost samples, the longest first."""

    step: float
    """Resolution of the encoder, rad; 0 if not visible."""

    noise: float
    """Standard deviation of white noise without quantisation noise, rad."""

    def sentence(self) -> str:
        """The figures in one line."""
        step = f"steps of {plain(1e3 * self.step, 4)} mrad" if self.step else "no steps seen"
        noise = f"noise {plain(1e3 * self.noise)} mrad" if self.noise or not self.step else "noise below the steps"
        lost = f"{self.lost} lost" + (
            f", longest gap {self.gaps[0].length:.3g} s at {self.gaps[0].begin:.3f} s" if self.gaps else ""
        )
        rates = " and ".join(f"{1 / period:.4g}" for period in self.periods)
        rate = f"{rates} Hz, jitter {plain(round(1e3 * self.jitter, 6))} ms" if self.periods else "one sample"
        return f"{self.name}: {self.samples} samples, {rate}, {lost}; {step}, {noise}"

    def settings(self) -> dict[str, float]:
        """Values for a scene about the encoder."""
        i = self.name[-3:]
        return {
            f"estimator.quantum{i}": float(f"{self.step:.6g}"),
            f"estimator.sigma{i}": float(f"{self.noise:.3g}"),
        }

    def lines(self) -> str:
        """Lines for a scene about the encoder."""
        return _lines(self.settings())


@dataclass(frozen=True)
class Changes:
    """How fast a command changes."""

    name: str
    size: float
    """Root mean square of its changes within 0.1 s, N·m or rad."""

    def sentence(self) -> str:
        """The figure in one line."""
        return f"{self.name}: changes by {self.size:.3g} {SCALES[self.name][1]} (rms) within {WITHIN:g} s"

    def lines(self) -> str:
        """The line for a scene about the command."""
        return _lines({SCALES[self.name][0]: float(f"{self.size:.3g}")})


def _lines(settings: dict[str, float]) -> str:
    return ", ".join(f'"{name}": {value:g}' for name, value in settings.items())


def changes(given: Recording) -> list[Changes]:
    """Measures the changes of each command that changes."""
    found = [Changes(name, _change(given, name)) for name in SCALES if name in given.columns]
    return [each for each in found if each.size > 0]


def _change(given: Recording, name: str) -> float:
    """Root mean square of the changes of a command within `WITHIN`, 0 if the record is shorter. No change is counted across a gap."""
    squares = []
    for begin, end in pairwise((0, *given.begins, len(given.time))):
        known = begin + np.flatnonzero(np.isfinite(given.columns[name][begin:end]))
        time, value = given.time[known], given.columns[name][known]
        if len(time) < 2:
            continue
        after = time + WITHIN
        last = np.searchsorted(time, after * (1 + 1e-12), side="right") - 1
        covered = after - time[last] < LOST * float(np.median(np.diff(time)))
        squares.append(((value[last] - value)[covered & (after <= time[-1])]) ** 2)
    every = np.concatenate(squares) if squares else np.empty(0)
    return float(np.sqrt(np.mean(every))) if len(every) else 0.0


def measure(given: Recording) -> list[Quality]:
    """Measures the figures of each encoder with samples."""
    return [_of(given, name) for name in MEASURED if name in given.columns and np.isfinite(given.columns[name]).any()]


def _of(given: Recording, name: str) -> Quality:
    column = given.columns[name]
    known = [
        begin + np.flatnonzero(np.isfinite(column[begin:end]))
        for begin, end in pairwise((0, *given.begins, len(column)))
    ]
    series = [(given.time[rows], column[rows]) for rows in known if len(rows)]
    values = np.concatenate([angles for _, angles in series])
    series = [each for each in series if len(each[0]) > 1]
    if not series:
        return Quality(name, len(values), (), 0.0, 0.0, 0, (), 0.0, 0.0)
    own = [np.diff(time) for time, _ in series]
    steps, begins = np.concatenate(own), np.concatenate([time[:-1] for time, _ in series])
    usual = float(np.median(steps))
    medians = [float(np.median(each)) if len(each) + 1 >= SERIES else usual for each in own]
    period = np.repeat(medians, [len(each) for each in own])
    long = steps > LOST * period
    order = np.argsort(-steps[long], kind="stable")
    columns = (begins[long][order], steps[long][order], (steps / period)[long][order])
    step = find_step(values)
    return Quality(
        name,
        len(values),
        tuple(distinct(np.array(medians))),
        float(np.std((steps - period)[~long])),
        float(np.std((steps / period)[~long])),
        int(np.sum(np.round(steps[long] / period[long]) - 1)),
        tuple(Gap(*each) for each in zip(*(column.tolist() for column in columns), strict=True)),
        step,
        find_noise([*zip(series, medians, strict=True)], step),
    )


@dataclass(frozen=True)
class Still:
    """Equal readings of an encoder while the other one moves."""

    begin: float
    """s."""

    end: float
    reading: float
    """rad."""

    other: float
    """Motion of the other encoder, rad."""

    commanded: float
    """Motion of the encoder's own command, rad; 0 without commands."""

    is_all: bool
    """Whether it has no other reading in the whole record."""


def find_still(given: Recording, i: int) -> Still | None:
    """The equal readings of encoder `i` during which the other one moves most; None without any."""
    own, other = given.columns[MEASURED[i]], given.columns[MEASURED[1 - i]]
    rows = np.flatnonzero(np.isfinite(own) & np.isfinite(other))
    ends = [0, *(np.flatnonzero(np.diff(own[rows]) != 0) + 1).tolist(), len(rows)]
    runs = [rows[a:b] for a, b in pairwise(ends) if b - a >= STILL]
    if not runs:
        return None
    run = max(runs, key=lambda run: float(np.ptp(other[run])))
    command = given.columns.get(SERVOS[i], np.zeros(len(own)))
    return Still(
        float(given.time[run[0]]),
        float(given.time[run[-1]]),
        float(own[run[0]]),
        float(np.ptp(other[run])),
        float(np.ptp(command[run])),
        len(run) == len(rows),
    )


def find_step(values: Array) -> float:
    """The largest step such that all differences of the values are multiples of it; 0 if there is none."""
    # If the numbers were written by a program with float32, differences below its resolution count as equal.
    is_short = bool(np.all(values == values.astype(np.float32)))
    size = float(np.max(np.abs(values))) or 1.0
    apart = np.diff(np.unique(values))
    apart = apart[apart > (3e-7 if is_short else 1e-9) * size]
    if len(apart) < FEWEST:
        return 0.0
    step = float(np.min(apart))
    counts = np.round(apart / step)
    step = float(np.sum(apart) / np.sum(counts))
    # Continuous noise leaves remainders with an rms of 0.29 of a step.
    remainder = apart / step - np.round(apart / step)
    return step if float(np.sqrt(np.mean(remainder**2))) < 0.05 else 0.0


def find_noise(series: list[tuple[tuple[Array, Array], float]], step: float) -> float:
    """Standard deviation of white noise, rad, from third differences, because the motion itself contributes almost nothing to them.

    A series has times, angles and its median step.
    """
    found = []
    for (time, angles), period in series:
        even = np.abs(np.diff(time) - period) < EVEN * period
        third = np.diff(angles, 3)[even[:-2] & even[1:-1] & even[2:]] ** 2 / THIRD if len(angles) > 3 else np.empty(0)
        moved = np.abs(np.diff(angles))[: len(third)]
        for k in range(0, len(third) - WINDOW + 1, WINDOW):
            found.append((float(np.mean(moved[k : k + WINDOW])), float(np.mean(third[k : k + WINDOW]))))
    if not found:
        return 0.0
    speed, variance = np.array(found).T
    # Quantisation errors are white if each sample moves by a step or more; at rest they hide the noise.
    moving = speed > step
    chosen = np.sort(variance[moving] if moving.sum() >= 3 else variance)
    # The middle half excludes windows with impacts and windows at rest.
    total = float(np.mean(chosen[len(chosen) // 4 : len(chosen) - len(chosen) // 4]))
    rounding = step**2 / 12
    return float(np.sqrt(total - rounding)) if total > 1.5 * rounding else 0.0
