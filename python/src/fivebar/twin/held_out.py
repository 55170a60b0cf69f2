"""Quality of a twin's predictions of both encoders in the held-out part of a record: the last third of each series of samples.

Innovations are errors from one sample to the next. Forecasts are judged at a fifth and at the end of their horizon, beside predictors without
mechanics. A band is judged by counting the errors inside.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf
from scipy.stats import chi2

from fivebar.plain import plain
from fivebar.scene_file import OFFSETS
from fivebar.twin import scene, setup, turn
from fivebar.twin.config import Config
from fivebar.twin.figures import COVERED, FEWEST, FEWEST_SEEN, Story, between, or_none
from fivebar.twin.follower import LONGEST_GAP
from fivebar.twin.forecast import POINTS
from fivebar.twin.messages import MEASURED, SERVOS, TRACKED

Array = NDArray[np.float64]

SHARE: Final = 1 / 3
"""Held-out share of the time of each series."""

LEVEL: Final = 0.95
"""Probability of the judged bands."""

WIDTH: Final = 1.959964
"""Half-width of the 95 % band of a normal distribution, in standard deviations."""

JUDGED: Final = (1, POINTS - 1)
"""Judged points of a forecast's path: for a horizon of 0.5 s they are 0.1 and 0.5 s ahead."""

RATED: Final = 5
"""Samples in the fit of the constant velocity; with only two, the encoder's resolution would dominate the motion."""

WORSE: Final = 1.2
"""Allowed error of the nearer forecasts, relative to the best predictor without mechanics."""

RESTS: Final = 10.0
"""Maximum range of the readings of a resting encoder, in standard deviations: white noise spans about 7, toggling between two steps 3.5."""

LONGEST_DELAY: Final = 0.5
"""Maximum delay between a command and the angle, s."""


@dataclass(frozen=True)
class Errors:
    """Errors of predicted readings, with their bands; NaN if a reading or a prediction is missing."""

    time: Array
    """(n), s: time of the reading."""

    error: Array
    """(n, 2), rad."""

    distance: Array
    """(n, 1) or (n, 2): error relative to the half-width of its 95 % band, for both encoders together or for each."""

    level: Array
    """Probability of the band with the error on its edge, same shape."""

    @property
    def count(self) -> int:
        """Number of predictions with a reading."""
        return int(np.isfinite(self.error).any(axis=1).sum())

    def coverage(self, level: float = LEVEL) -> float:
        """Share of the errors inside the band of a probability."""
        known = self.level[np.isfinite(self.level)]
        return float(np.mean(known <= level)) if len(known) else math.nan

    def relative_width(self) -> float:
        """Median half-width divided by the 95th percentile of the errors: 1 is exact, more is too wide."""
        known = self.distance[np.isfinite(self.distance)]
        largest = float(np.quantile(known, LEVEL)) if len(known) else math.nan
        return 1 / largest if largest > 0 else math.nan

    def content(self) -> dict[str, Any]:
        return {
            "count": self.count,
            **sizes(self.error),
            "coverage95": or_none(self.coverage()),
            "relative_width95": or_none(self.relative_width()),
        }


def sizes(error: Array) -> dict[str, list[float | None]]:
    """Median and rms error of each encoder, mrad."""
    columns = [np.abs(column[np.isfinite(column)]) for column in error.T]
    return {
        "median_mrad": [or_none(1e3 * float(np.median(each))) if len(each) else None for each in columns],
        "rms_mrad": [or_none(1e3 * float(np.sqrt(np.mean(each**2)))) if len(each) else None for each in columns],
    }


class Forecasts(NamedTuple):
    """Forecasts of one distance in time."""

    ahead: float
    """Time from the forecast's state to the predicted reading, s."""

    errors: Errors
    half_width: Array
    """(n, 2), rad."""

    others: dict[str, Array]
    """Errors (n, 2) of the other predictors for the same readings, by predictor."""


@dataclass
class HeldOut:
    """All results of the judgement."""

    noise: Array
    """(2), rad: standard deviation of a reading due to noise and resolution of its encoder."""

    series: int = 0
    samples: int = 0
    seconds: float = 0.0
    innovations: Errors = field(default_factory=lambda: Errors(np.empty(0), *np.empty((3, 0, 2))))
    forecasts: list[Forecasts] = field(default_factory=list)
    delay: float | None = None
    """Delay from a command to the angle, s; None without commands."""

    known_commands: bool = False
    """Whether forecasts and the last command as a predictor know the commands of their time."""

    not_judged: list[str] = field(default_factory=list)
    """Sentences about quantities that could not be judged."""

    def content(self) -> dict[str, Any]:
        """All figures in nested objects."""
        found = {
            "series": self.series,
            "samples": self.samples,
            "seconds": or_none(self.seconds),
            "innovations": self.innovations.content(),
            "forecasts": {
                f"{each.ahead:.3g}": each.errors.content()
                | {"others": {name: sizes(error) for name, error in each.others.items()}}
                for each in self.forecasts
            },
            "command_delay_s": self.delay,
            "known_commands": self.known_commands,
            "not_judged": self.not_judged,
        }
        return found | {"missed": self.missed()}

    def missed(self) -> list[str]:
        """Sentences about the promises that were not kept."""
        found = []
        for what, errors in (
            ("innovations", self.innovations),
            *((f"forecasts {each.ahead:.3g} s ahead", each.errors) for each in self.forecasts),
        ):
            covered = errors.coverage()
            if errors.count >= FEWEST and covered < COVERED:
                found.append(
                    f"{plain(100 * covered)} % of the {what} are inside their 95 % bands; {100 * COVERED:g} % are promised"
                )
        return found + [sentence for each in self.forecasts[:1] for sentence in self._worse(each)]

    def _worse(self, given: Forecasts) -> list[str]:
        """Sentences about encoders with worse forecasts than a predictor without mechanics."""
        found = []
        for i in range(2):
            known = given.errors.error[np.isfinite(given.errors.error[:, i]), i]
            if len(known) < FEWEST:
                continue
            rms = {name: float(np.sqrt(np.nanmean(error[:, i] ** 2))) for name, error in given.others.items()}
            best = min(rms, key=lambda name: rms[name])
            own = float(np.sqrt(np.mean(known**2)))
            # At rest, repeating the last reading has no error, but a reading is only known to the encoder's noise and resolution.
            if own > WORSE * max(rms[best], float(self.noise[i])):
                found.append(
                    f"forecasts of encoder {i + 1} {given.ahead:.3g} s ahead are {plain(1e3 * own)} mrad off (rms), and `{best}` {plain(1e3 * rms[best])} mrad; "
                    f"at most {WORSE:g} times as much is promised"
                )
        return found


class Series(NamedTuple):
    """Samples without a long gap, as true angles if the scene has mounting angles."""

    time: Array
    angles: Array
    """(n, 2), rad, without jumps by whole turns; NaN if there is no reading."""

    commands: Array
    """(n, 2), rad, in the same turn as the angles; NaN without commands."""

    @property
    def begin(self) -> float:
        """Begin of the held-out part, s."""
        return float(self.time[-1] - SHARE * (self.time[-1] - self.time[0]))

    def held_out(self, i: int) -> Array:
        """Readings of encoder `i` in the held-out part, rad."""
        column: Array = self.angles[self.time >= self.begin, i]
        known: Array = column[np.isfinite(column)]
        return known


def judge(config: Config, story: Story, known_commands: bool = False) -> HeldOut:
    """Judges the predictions in a run's record, which forecasts made with or without the commands of their time."""
    about = scene.read(Path(config.scene))
    encoders = setup.encoders(config.machine, about.values)
    sigma, quantum = (np.array([encoders[f"estimator.{name}[{i}]"] for i in (1, 2)]) for name in ("sigma", "quantum"))
    found = HeldOut(noise=np.hypot(sigma, quantum / math.sqrt(12)), known_commands=known_commands)
    series = _series(story, np.array([about.offsets.get(name, 0.0) for name in OFFSETS]))
    delay = _delay(series)
    found.delay = None if delay is None else or_none(delay)
    if series:
        found.series, found.seconds = len(series), sum(float(each.time[-1]) - each.begin for each in series)
        found.samples = sum(int((each.time >= each.begin).sum()) for each in series)
        found.innovations = Errors(*_joined([_innovations(story, each) for each in series]))
        for place in JUDGED:
            found.forecasts += _forecasts(story, series, place, found)
    found.not_judged += _not_judged(story, found)
    for i in range(2):
        spans = [np.ptp(known) for each in series if len(known := each.held_out(i))]
        if spans and max(spans) <= RESTS * found.noise[i]:
            found.not_judged.append(
                f"motion of encoder {i + 1}: it rests in the held-out part, which every predictor knows"
            )
    return found


def _not_judged(story: Story, found: HeldOut) -> list[str]:
    """Sentences about quantities that the record is not sufficient to judge."""
    said = []
    if not all(np.isfinite(story.measured[name]).any() for name in TRACKED):
        said.append("the tip, and with it the lengths: the record has no tip.x and tip.y")
    if found.delay is None:
        said.append("the last command as a predictor: the record has no servo.theta[1] and servo.theta[2]")
    if found.innovations.count < FEWEST:
        said.append(f"innovations: {found.innovations.count} in the held-out part; {FEWEST} or more are needed")
    for each in found.forecasts:
        if each.errors.count < FEWEST:
            said.append(
                f"forecasts {each.ahead:.3g} s ahead: {each.errors.count} end in the held-out part; {FEWEST} or more are needed"
            )
    return said if found.forecasts else [*said, "forecasts: none begins in the held-out part"]


def _series(story: Story, offsets: Array) -> list[Series]:
    """The samples of a record, sorted by time and split into series at pauses."""
    order = np.argsort(story.measured["time"], kind="stable")
    time = story.measured["time"][order]
    angles, commands = (
        np.column_stack([story.measured[name][order] for name in names]) - offsets for names in (MEASURED, SERVOS)
    )
    begins = np.flatnonzero(np.diff(time) > LONGEST_GAP) + 1
    found = []
    for rows in np.split(np.arange(len(time)), begins):
        rows = rows[np.diff(time[rows], prepend=-np.inf) > 0]
        if np.isfinite(angles[rows]).all(axis=1).sum() < RATED:
            continue
        whole = np.column_stack([_unwrapped(column) for column in angles[rows].T])
        apart = commands[rows] - whole
        turns = np.array(
            [
                np.round(np.median(gap[np.isfinite(gap)]) / turn.TURN) if np.isfinite(gap).any() else 0.0
                for gap in apart.T
            ]
        )
        found.append(Series(time[rows], whole, commands[rows] - turn.TURN * turns))
    return found


def _unwrapped(column: Array) -> Array:
    """Angles without jumps by whole turns."""
    found = column.copy()
    known = np.isfinite(column)
    found[known] = np.unwrap(column[known])
    return found


def _joined(parts: list[tuple[Array, ...]]) -> list[Array]:
    """Concatenates the arrays of all series."""
    return [np.concatenate(each) for each in zip(*parts, strict=True)]


def _innovations(story: Story, series: Series) -> tuple[Array, Array, Array, Array]:
    """Fields of `Errors` for the innovations of a series: both encoders together, by the unit's normalised innovation squared."""
    table = story.estimated
    rows = np.flatnonzero((table["sample"] >= series.begin) & (table["sample"] <= series.time[-1]))
    read = np.isfinite(series.angles[_newest(series.time, table["sample"][rows])])
    error = np.where(read, np.column_stack([table[f"estimated.innovation[{i}]"][rows] for i in (1, 2)]), np.nan)
    square, count = table["estimated.nis"][rows], read.sum(axis=1)
    # Without a reading, there is no distribution of the squared innovation.
    square, count = np.where(count > 0, square, np.nan), np.maximum(count, 1)
    distance = np.sqrt(square / chi2.ppf(LEVEL, count))
    return table["sample"][rows], error, distance[:, None], chi2.cdf(square, count)[:, None]


def _newest(time: Array, at: Array) -> NDArray[np.intp]:
    """Index of the last time before or at each time `at`; times of a record are rounded to less than 1 µs."""
    return np.maximum(np.searchsorted(time, at + 1e-6, side="right") - 1, 0)


def _forecasts(story: Story, series: list[Series], place: int, found: HeldOut) -> list[Forecasts]:
    """Forecasts of one point of the path, if there are any."""
    path = {name: column[place::POINTS] for name, column in story.forecasts.all().items()}
    parts = [_of_series(story, path, each, found) for each in series]
    names = ("hold", "constant velocity", *(("last command",) if found.delay is not None else ()))
    time, error, half_width, *others = _joined(parts)
    if not len(time):
        return []
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.abs(error) / half_width
    errors = Errors(time, error, distance, erf(WIDTH * distance / math.sqrt(2)))
    return [Forecasts(float(np.median(path["ahead"])), errors, half_width, dict(zip(names, others, strict=True)))]


def _of_series(story: Story, path: dict[str, Array], series: Series, found: HeldOut) -> tuple[Array, ...]:
    """Times, errors, half-widths and errors of other predictors for the forecasts that begin in the held-out part of a series."""
    noise, delay = found.noise, found.delay
    rows = np.flatnonzero((path["time"] >= series.begin) & (path["time"] <= series.time[-1]))
    begin, at = path["time"][rows], (path["time"] + path["ahead"])[rows]
    order = np.argsort(story.estimated["time"], kind="stable")
    begins = order[_newest(story.estimated["time"][order], begin)] if len(order) else np.empty(0, dtype=np.intp)
    sample = story.estimated["sample"][begins]
    columns = []
    for i in range(2):
        known = np.isfinite(series.angles[:, i])
        time, angle = series.time[known], series.angles[known, i]
        if known.sum() < max(RATED, FEWEST_SEEN):
            columns.append([np.full(len(rows), np.nan)] * (4 + (delay is not None)))
            continue
        truth = between(time, angle)
        newest = _newest(time, sample)
        # An estimate may be in another turn than the readings.
        turns = np.round((story.estimated[f"theta[{i + 1}]"][begins] - angle[newest]) / turn.TURN)
        own = path[f"theta[{i + 1}]"][rows] - turn.TURN * turns
        half_width = WIDTH * np.hypot(path[f"estimated.theta.sigma[{i + 1}]"][rows], noise[i])
        predicted = [own, angle[newest], angle[newest] + _rates(time, angle)[newest] * (at - time[newest])]
        if delay is not None:
            newest_known = at - delay if found.known_commands else np.minimum(sample, at - delay)
            predicted.append(np.interp(newest_known, series.time, series.commands[:, i]))
        error = np.array(predicted) - truth(at)
        # All predictors are compared on the same readings.
        error[:, ~np.isfinite(error).all(axis=0)] = np.nan
        columns.append([error[0], half_width, *error[1:]])
    error, half_width, *others = (np.column_stack(pair) for pair in zip(*columns, strict=True))
    return at, error, half_width, *others


def _rates(time: Array, angle: Array) -> Array:
    """Slope of a line fitted to the last `RATED` samples up to each sample, rad/s; NaN for the first samples."""
    times, angles = (np.lib.stride_tricks.sliding_window_view(each, RATED) for each in (time, angle))
    off = times - times.mean(axis=1, keepdims=True)
    rates = (off * angles).sum(axis=1) / (off**2).sum(axis=1)
    return np.concatenate([np.full(RATED - 1, np.nan), rates])


def _delay(series: list[Series]) -> float | None:
    """The delay, s, that best aligns commands and angles before the held-out parts; None without commands."""
    parts = [each for each in series if np.isfinite(each.commands).all()]
    if not parts or len(parts) < len(series):
        return None
    period = float(np.median(np.concatenate([np.diff(each.time) for each in parts])))
    delays = np.linspace(0.0, LONGEST_DELAY, 1 + min(200, round(LONGEST_DELAY / period)))

    def off(delay: float) -> float:
        total = 0.0
        for each in parts:
            seen = each.time < each.begin
            for i in range(2):
                commanded = np.interp(each.time[seen] - delay, each.time, each.commands[:, i])
                total += float(np.nansum((commanded - each.angles[seen, i]) ** 2))
        return total

    return float(min(delays, key=off))


def lines(content: dict[str, Any]) -> list[str]:
    """The figures as a table: a row for each error with median and rms of both encoders, and the counted coverage of the bands."""

    def number(value: float | None, factor: float = 1.0) -> str:
        return "–" if value is None else plain(factor * value)

    def row(name: str, given: dict[str, Any]) -> str:
        errors = [number(value) for pair in zip(given["median_mrad"], given["rms_mrad"], strict=True) for value in pair]
        counted = [number(given["coverage95"], 100), number(given["relative_width95"])] if "coverage95" in given else []
        return f"  {name:26}" + "".join(f" {text:>8}" for text in (*errors, *counted))

    delay = content["command_delay_s"]
    found = [
        f"held out: {content['samples']} samples, {number(content['seconds'])} s in {content['series']} series"
        + ("" if delay is None else f"; commands arrive after {1e3 * delay:.3g} ms")
        + ("; forecasts know the later commands" if content["known_commands"] else ""),
        f"  {'errors, mrad':26}{'1 median':>9}{'rms':>9}{'2 median':>9}{'rms':>9}{'inside %':>9}{'width':>9}",
        row("innovations", content["innovations"]),
    ]
    for ahead, given in content["forecasts"].items():
        found.append(row(f"forecasts, {ahead} s", given))
        found += [row(f"  {name}", others) for name, others in given["others"].items()]
    return found + [f"not judged: {sentence}" for sentence in content["not_judged"]]
