"""Figures of a run, from its record and the counters of its processes."""

import itertools
import math
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from fivebar.plain import plain
from fivebar.twin import record, scene
from fivebar.twin.config import Config
from fivebar.twin.forecast import ANGLES, RADIUS, covariance, half_width
from fivebar.twin.messages import MEASURED, SERVOS, TRACKED, topic
from fivebar.twin.turn import TURN
from fivebar.twin.watch import Histogram

ESTIMATES: Final = (
    "tip.x",
    "tip.y",
    "estimated.nis",
    "estimated.alarm",
    "estimated.tau[1]",
    "estimated.tau[2]",
    "estimated.status",
    "estimated.innovation[1]",
    "estimated.innovation[2]",
    "theta[1]",
    "theta[2]",
)

COVERED: Final = 0.9
"""Promised share of tips inside the forecasts' 95 % circles at the horizon, for every scene (docs/pipeline.md)."""

NARROW: Final = {"pick_and_place": 2.5}
"""Promised median half-width at a horizon of 0.5 s by scene, mm. Measured on pick_and_place: 1.9 mm over 15 s, 2.14 mm in the first second. A freely
falling machine may be anywhere after 0.5 s, so that such scenes have no promised width."""

MISSED: Final = 3
"""Exit code of a run with worse forecasts than promised."""

FEWEST: Final = 20
"""Minimum number of forecasts for a judgement."""

NEAR: Final = 0.1
"""Maximum distance of an estimate from its own sample, rad; beyond it, the sample was not followed. At 7 rad/s and a period of 5 ms it is 0.01 rad."""

FOLLOWED: Final = 0.5
"""Minimum share of followed samples; refused samples count as not followed."""


@dataclass
class Table:
    """Growing columns, 8 bytes per number."""

    names: tuple[str, ...]
    columns: "dict[str, array[float]]" = field(init=False)

    def __post_init__(self) -> None:
        self.columns = {name: array("d") for name in self.names}

    def add(self, row: dict[str, float]) -> None:
        """Appends a row; missing values become NaN."""
        for name, column in self.columns.items():
            column.append(row.get(name, math.nan))

    def __getitem__(self, name: str) -> np.ndarray:
        return np.frombuffer(self.columns[name]) if len(self) else np.empty(0)

    def all(self) -> dict[str, np.ndarray]:
        """All columns by name."""
        return {name: self[name] for name in self.names}

    def __len__(self) -> int:
        return len(self.columns[self.names[0]])


class Gap(NamedTuple):
    """Range of message numbers of one kind that the record lacks."""

    of: str
    first: int
    last: int
    why: str


@dataclass
class Story:
    """Series from a record: times in s after its first message."""

    origin: int = 0
    measured: Table = field(default_factory=lambda: Table(("time", *MEASURED, *SERVOS, *TRACKED)))
    estimated: Table = field(default_factory=lambda: Table(("time", "sample", *ESTIMATES, "band")))
    """`sample` is the time of the newest sample."""
    forecasts: Table = field(
        default_factory=lambda: Table(("time", "ahead", "tip.x", "tip.y", *ANGLES, "half_width", "last"))
    )
    alarms: list[tuple[float, str, str]] = field(default_factory=list)
    """Time in s, state, and cause: the twin's name for it if there is one, else the watch's."""
    gaps: "list[Gap]" = field(default_factory=list)
    bad: list[str] = field(default_factory=list)
    """Reasons why rows are not valid messages."""
    samples: set[int] = field(default_factory=set)
    used: set[int] = field(default_factory=set)
    followed: int = 0
    """Number of samples with an estimate within `NEAR`."""
    sent: int = 0
    """Number of forecasts."""
    learned: dict[str, dict[str, float]] | None = None
    """Learned parameters at the end: values and standard deviations, and the corresponding start values of a unit."""


def read(file: Path) -> Story:
    """Reads a record in one pass."""
    story = Story()
    waiting: dict[int, dict[str, float]] = {}
    for message in record.messages(
        file, "meas", "est", "forecast", "alarm", "learned", "gap", refused=story.bad.append
    ):
        story.origin = story.origin or message.time
        fields, time = message.fields, 1e-9 * (message.time - story.origin)
        if message.kind == "meas":
            if message.seq not in story.samples:
                story.samples.add(message.seq)
                story.measured.add({"time": time} | fields)
                waiting[message.seq] = fields
        elif message.kind == "est":
            taken = [entry for entry in message.extra["inputs"] if entry[0] == "meas"]
            story.used |= {entry[1] for entry in taken}
            sample = 1e-9 * (taken[-1][2] - story.origin) if taken else math.nan
            band = half_width(covariance(fields)) if "estimated.tip.cov[1]" in fields else math.nan
            story.estimated.add({"time": time, "sample": sample, "band": band} | fields)
            seen = waiting.pop(message.seq, {})
            story.followed += all(
                abs(math.remainder(seen[name] - fields[name.removeprefix("measured.")], TURN)) < NEAR
                for name in MEASURED
                if name in seen
            )
        elif message.kind == "forecast":
            _forecast(story, message.extra, time)
        elif message.kind == "alarm":
            story.alarms.append(
                (time, str(message.extra.get("state")), str(message.extra.get("named", message.extra.get("cause"))))
            )
        elif message.kind == "learned":
            story.learned = {"estimated": fields, "values": message.extra["values"]}
        else:
            story.gaps.append(
                Gap(message.extra["of"], int(fields["first"]), int(fields["last"]), message.extra.get("why", ""))
            )
    return story


def _forecast(story: Story, extra: dict[str, Any], time: float) -> None:
    path = extra["path"]
    story.sent += 1
    count = len(path["ahead"])
    for i, ahead in enumerate(path["ahead"]):
        row = {"time": time, "ahead": ahead, "tip.x": path["tip.x"][i], "tip.y": path["tip.y"][i]}
        # Records of older versions contain no angles.
        angles = {name: path[name][i] for name in ANGLES if name in path}
        story.forecasts.add(row | angles | {"half_width": path[RADIUS][i], "last": float(i == count - 1)})


@dataclass
class Judged:
    """Estimates and forecasts compared with the tracked motion; NaN where the tracker has no data."""

    error: np.ndarray
    """Error of the estimated tip, m."""

    ahead_error: np.ndarray
    """Error of the forecast tip, m."""

    inside: np.ndarray
    """1 if the tip was inside the circle, else 0."""


FEWEST_SEEN: Final = 4
"""Minimum number of samples for a spline."""


def between(time: np.ndarray, seen: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Spline through samples at rising times. It returns NaN in gaps of more than five median sampling steps and beyond the ends."""
    spline = CubicSpline(time, seen)
    widest = 5 * float(np.median(np.diff(time)))

    def at_times(at: np.ndarray) -> np.ndarray:
        values: np.ndarray = spline(at)
        after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
        values[(at < time[0]) | (at > time[-1]) | (time[after] - time[after - 1] > widest)] = np.nan
        return values

    return at_times


def judge(story: Story) -> Judged:
    """Compares estimates and forecasts with a tracker's tip, interpolated by a spline."""
    estimated, forecasts = story.estimated, story.forecasts
    nothing = Judged(np.full(len(estimated), np.nan), np.full(len(forecasts), np.nan), np.full(len(forecasts), np.nan))
    order = np.argsort(story.measured["time"], kind="stable")
    time = story.measured["time"][order]
    seen = np.column_stack([story.measured[name][order] for name in TRACKED])
    usable = np.isfinite(seen).all(axis=1) & (np.diff(time, prepend=-np.inf) > 0)
    if usable.sum() < FEWEST_SEEN:
        return nothing
    truth = between(time[usable], seen[usable])

    def tip(table: Table) -> np.ndarray:
        return np.column_stack([table[name] for name in TRACKED])

    off = tip(forecasts) - truth(forecasts["time"] + forecasts["ahead"])
    ahead = np.linalg.norm(off, axis=1)
    hit = np.where(np.isfinite(ahead), ahead <= forecasts["half_width"], np.nan)
    return Judged(np.linalg.norm(tip(estimated) - truth(estimated["time"]), axis=1), ahead, hit)


def causes(alarms: list[tuple[float, str, str]]) -> list[str]:
    """The cause of each anomaly, taken from its last alarm, which uses the most samples; if the run ended before, from its first one."""
    states = [each for each in alarms if each[1] != "trouble"]
    pairs = itertools.zip_longest(states, states[1:], fillvalue=(math.inf, "", ""))
    return [
        end if after == "calibrating" else begin for (_, state, begin), (_, after, end) in pairs if state == "anomaly"
    ]


def or_none(value: float, digits: int = 6) -> float | None:
    """A rounded number, or None for NaN and infinity, which JSON lacks."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def _mean(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan


def _median(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan


def summarise(
    config: Config,
    story: Story,
    judged: Judged,
    status: dict[str, list[dict[str, Any]]],
    restarts: dict[str, int],
    troubles: Sequence[str] = (),
) -> dict[str, Any]:
    """All figures of a run in nested objects; unknown figures are null. `troubles` are the messages of the processes."""

    def total(process: str, name: str) -> int:
        return sum(int(life.get(name, 0)) for life in status.get(process, []))

    # A killed process has not reported its last half second of counts; the record has these messages.
    published = max(total("machine", "published"), len(story.samples))
    taken = max(total("follow", "taken"), len(story.used))
    latency = Histogram()
    for life in status.get("watch", []):
        for place, count in life.get("latency_bins", {}).items():
            latency.bins[int(place)] += count
            latency.count += count
    last = story.forecasts["last"] == 1.0
    error = judged.error[np.isfinite(judged.error)]
    by_ahead = {}
    for ahead in np.unique(np.round(story.forecasts["ahead"], 6)):
        here = np.isclose(story.forecasts["ahead"], ahead)
        by_ahead[f"{ahead:g}"] = {
            "coverage95": or_none(_mean(judged.inside[here])),
            "halfwidth_mm": or_none(1e3 * float(np.median(story.forecasts["half_width"][here]))),
            "error_mm": or_none(1e3 * float(np.sqrt(_mean(judged.ahead_error[here] ** 2)))),
            "error_median_mm": or_none(1e3 * _median(judged.ahead_error[here])),
        }
    times = story.estimated["time"]
    # The twin publishes a state for a forecast once per so many estimated samples.
    due = len(story.estimated) // max(1, round(1 / (config.forecast_rate * config.period)))
    content = {
        "scene": scene.read(Path(config.scene)).name,
        "unit": config.unit,
        "broker": "amqtt, embedded" if config.broker.embedded else f"{config.broker.host}:{config.broker.port}",
        "seconds": or_none(float(times[-1] - times[0]) if len(times) else math.nan),
        "samples": {
            "published": published,
            "lost": max(0, published - taken),
            "estimated": max(total("follow", "estimated"), len(story.estimated)),
            "recorded": len(story.samples),
            "followed": story.followed,
            "late": total("follow", "late"),
            "refused": total("follow", "refused_samples"),
            "why_refused": next(
                (life["why_refused"] for life in status.get("follow", []) if life.get("why_refused")), ""
            ),
        },
        "latency_ms": {
            name: or_none(1e3 * latency.quantile(share)) for name, share in (("p50", 0.5), ("p90", 0.9), ("p99", 0.99))
        },
        "tip_error_mm": {
            "rms": or_none(1e3 * math.sqrt(_mean(judged.error**2))) if len(error) else None,
            "median": or_none(1e3 * _median(error)),
            "p95": or_none(1e3 * float(np.quantile(error, 0.95))) if len(error) else None,
            "max": or_none(1e3 * float(error.max())) if len(error) else None,
        },
        "forecasts": {
            "count": story.sent,
            "judged": int(np.isfinite(judged.inside[last]).sum()),
            "due": due,
            "left_out": total("forecast", "left_out"),
            "ahead_s": config.horizon,
            "coverage95": or_none(_mean(judged.inside[last])),
            "halfwidth_mm": {
                "median": or_none(1e3 * float(np.median(story.forecasts["half_width"][last]))) if last.any() else None,
                "p95": or_none(1e3 * float(np.quantile(story.forecasts["half_width"][last], 0.95)))
                if last.any()
                else None,
            },
            "by_ahead": by_ahead,
        },
        "alarms": sum(state == "anomaly" for _, state, _ in story.alarms),
        "causes": causes(story.alarms),
        "troubles": {"count": len(troubles), "last": list(troubles[-10:])},
        "refused": sum(total(process, "refused") for process in status),
        "restarts": restarts,
        "gaps": [gap._asdict() for gap in story.gaps],
        "rows_refused": len(story.bad),
        "memory_mb": {
            process: round(max(life.get("memory_kb", 0) for life in lives) / 1024, 1)
            for process, lives in status.items()
        },
        "record": str(config.record),
        "learned": story.learned,
    }
    return content | {"missed": missed(content)}


def unfollowed(content: dict[str, Any]) -> str:
    """A sentence if fewer than `FOLLOWED` of the samples were followed, else ""."""
    samples = content["samples"]
    refused, followed = samples["refused"], samples["followed"]
    recorded = max(samples["recorded"], samples["published"] - samples["lost"] + refused)
    if samples["estimated"] and followed >= FOLLOWED * recorded:
        return ""
    if not recorded:
        return f"not followed: no sample has come on the topic {topic(content['unit'], 'meas')}"
    if refused >= FOLLOWED * recorded:
        return f"not followed: {refused} of {recorded} samples are refused, the first because: {samples['why_refused']}"
    return f"not followed: {followed} of {recorded} samples have an estimate within {NEAR:g} rad; {FOLLOWED:.0%} are needed: is the scene this machine's?"


def missed(content: dict[str, Any]) -> list[str]:
    """Sentences about the forecast promises that a run has not kept."""
    forecasts, scene = content["forecasts"], content["scene"]
    covered, width = forecasts["coverage95"], forecasts["halfwidth_mm"]["median"]
    found: list[str] = []
    if forecasts["judged"] < FEWEST:
        return found
    if covered < COVERED:
        found.append(
            f"{plain(100 * covered)} % of the tips are inside the 95 % circles {forecasts['ahead_s']:g} s ahead; {100 * COVERED:g} % are promised"
        )
    if width is not None and width > NARROW.get(scene, math.inf) and forecasts["ahead_s"] <= 0.5:
        found.append(f"the half-width is {width:.3g} mm (median); in {scene} at most {NARROW[scene]:g} mm are promised")
    return found
