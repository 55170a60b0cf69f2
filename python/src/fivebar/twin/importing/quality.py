"""How good an encoder's samples are: rate, jitter, lost samples, step and noise, and the lines of a scene that say so to the estimator."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from fivebar.twin.messages import MEASURED
from fivebar.twin.recording import Array, Recording

WINDOW: Final = 50
"""Samples whose third differences make one figure of the noise."""

THIRD: Final = 20.0
"""Variance of third differences of white noise of variance 1: 1 + 9 + 9 + 1."""

FEWEST: Final = 8
"""Differences of values that tell a step: fewer may be multiples of one by chance."""

LOST: Final = 1.5
"""Usual steps after which a sample is missing."""


@dataclass(frozen=True)
class Quality:
    """Figures of an encoder."""

    name: str
    samples: int
    period: float
    """The usual distance of two samples, s."""

    jitter: float
    """Standard deviation of that distance where none is lost, s."""

    lost: int
    gaps: tuple[tuple[float, float], ...]
    """Begin and length, s, of each time in which samples are lost, the longest first."""

    step: float
    """Of the encoder, rad; 0 if none is seen."""

    noise: float
    """Standard deviation of white noise beside that of the steps, rad."""

    def sentence(self) -> str:
        """The figures in a line."""
        step = f"steps of {1e3 * self.step:.4g} mrad" if self.step else "no steps seen"
        noise = f"noise {1e3 * self.noise:.3g} mrad" if self.noise or not self.step else "noise below the steps"
        lost = f"{self.lost} lost" + (
            f", longest gap {self.gaps[0][1]:.3g} s at {self.gaps[0][0]:.3f} s" if self.gaps else ""
        )
        rate = f"{1 / self.period:.4g} Hz, jitter {1e3 * self.jitter:.3g} ms" if self.period else "one sample"
        return f"{self.name}: {self.samples} samples, {rate}, {lost}; {step}, {noise}"

    def lines(self) -> str:
        """What a scene says of the encoder."""
        i = self.name[-3:]
        return f'"estimator.quantum{i}": {self.step:.6g}, "estimator.sigma{i}": {self.noise:.3g}'


def measure(given: Recording) -> list[Quality]:
    """The figures of each encoder that has samples."""
    return [_of(given, name) for name in MEASURED if name in given.columns and np.isfinite(given.columns[name]).any()]


def _of(given: Recording, name: str) -> Quality:
    column = given.columns[name]
    known = [
        begin + np.flatnonzero(np.isfinite(column[begin:end]))
        for begin, end in pairwise((0, *given.begins, len(column)))
    ]
    series = [(given.time[rows], column[rows]) for rows in known if len(rows)]
    values = np.concatenate([angles for _, angles in series])
    steps = np.concatenate([np.diff(time) for time, _ in series])
    begins = np.concatenate([time[:-1] for time, _ in series])
    if not len(steps):
        return Quality(name, len(values), 0.0, 0.0, 0, (), 0.0, 0.0)
    period = float(np.median(steps))
    long = steps > LOST * period
    order = np.argsort(-steps[long], kind="stable")
    gaps = tuple(zip(begins[long][order].tolist(), steps[long][order].tolist(), strict=True))
    step = find_step(values)
    return Quality(
        name,
        len(values),
        period,
        float(np.std(steps[~long])),
        int(np.sum(np.round(steps[long] / period) - 1)),
        gaps,
        step,
        find_noise(series, period, step),
    )


def find_step(values: Array) -> float:
    """The step of which all differences of the values are multiples, 0 if there is none."""
    # Less than float32 tells apart is one value, if the numbers were written by a program that computes in it.
    is_short = bool(np.all(values == values.astype(np.float32)))
    size = float(np.max(np.abs(values))) or 1.0
    apart = np.diff(np.unique(values))
    apart = apart[apart > (3e-7 if is_short else 1e-9) * size]
    if len(apart) < FEWEST:
        return 0.0
    step = float(np.min(apart))
    counts = np.round(apart / step)
    step = float(np.sum(apart) / np.sum(counts))
    # Noise without steps leaves remainders as large as 0.29 of the smallest difference.
    remainder = apart / step - np.round(apart / step)
    return step if float(np.sqrt(np.mean(remainder**2))) < 0.05 else 0.0


def find_noise(series: list[tuple[Array, Array]], period: float, step: float) -> float:
    """Standard deviation of white noise, rad, by third differences: the motion itself has hardly any within three samples."""
    found = []
    for time, angles in series:
        even = np.abs(np.diff(time) - period) < 0.2 * period
        third = np.diff(angles, 3)[even[:-2] & even[1:-1] & even[2:]] ** 2 / THIRD if len(angles) > 3 else np.empty(0)
        moved = np.abs(np.diff(angles))[: len(third)]
        for k in range(0, len(third) - WINDOW + 1, WINDOW):
            found.append((float(np.mean(moved[k : k + WINDOW])), float(np.mean(third[k : k + WINDOW]))))
    if not found:
        return 0.0
    speed, variance = np.array(found).T
    # Rounding is white where each sample has moved by a step or more, and hides noise at rest.
    moving = speed > step
    chosen = np.sort(variance[moving] if moving.sum() >= 3 else variance)
    # The middle half: neither the windows in which the machine is hit nor those in which it rests.
    total = float(np.mean(chosen[len(chosen) // 4 : len(chosen) - len(chosen) // 4]))
    rounding = step**2 / 12
    return float(np.sqrt(total - rounding)) if total > 1.5 * rounding else 0.0
