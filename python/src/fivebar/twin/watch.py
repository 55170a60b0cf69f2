"""The watch's process: looks at the estimates and says when something is wrong, once, with cause and figures.

It goes through the states of the Incubator's supervisor: listening → anomaly → calibrating → cooling down → listening. A cause has to
last before it counts, and to be gone before it counts as gone; nothing counts while the twin is still finding its state. Something is
wrong where the unit's alarm is on or where it names an encoder or the clocks. An encoder that fails during another anomaly is one of its
own, at once; one that stays dead is told once.
"""

import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fivebar.twin import process
from fivebar.twin.config import Config
from fivebar.twin.intake import Newest, Orders
from fivebar.twin.messages import Message
from fivebar.twin.process import AGAIN, Worker

CAUSES: Final = (
    "nothing",
    "torque at motor 1",
    "torque at motor 2",
    "force at the tip",
    "encoder 1",
    "encoder 2",
    "parameters",
    "timing",
)
"""Names of the values of `estimated.cause`."""

FAULTS: Final = ("encoder 1", "encoder 2", "timing")
"""Those of `CAUSES` that are wrong whether or not the alarm is on: an alarm is for forces only."""

FORCE_FIGURES: Final = (
    "estimated.nis",
    "estimated.tau[1]",
    "estimated.tau[2]",
    "estimated.tau.sigma[1]",
    "estimated.tau.sigma[2]",
)
"""Told with a force; with a fault, the status."""

STARTING: Final = 2.0
"""Seconds after the first estimate, or after a gap, in which nothing is an alarm."""

NO_SAMPLE: Final = 30_000_000_000
"""Nanoseconds without any sample after which that is an alarm."""

JUMPED: Final = 10_000_000_000
"""Nanoseconds by which a time is earlier that is of another clock."""

BEHIND: Final = 1.0
"""Seconds by which an estimate may come later after its sample than the soonest one did: beyond that something does not keep up."""

log = logging.getLogger("fivebar")


@dataclass(frozen=True)
class Settings:
    """Times in s."""

    on: float = 0.04
    """Time that a cause lasts before it is an anomaly, s."""

    off: float = 0.5
    """Time for which the cause is gone before the anomaly is over, s."""

    calibrating: float = 2.0
    """Time of samples gathered afterwards for a calibration, s."""

    cooling: float = 5.0
    """No further alarm of a force for so long, and none of a fault, or of silence, that has been away for less."""

    silence: float = 0.5
    """Without estimates."""


@dataclass
class Cause:
    """Something that is wrong, or not: with hysteresis in time."""

    name: str
    since: float = math.nan
    """When it began, NaN while it is not there."""

    last: float = -math.inf
    most: float = 0.0
    told: bool = False
    """Whether it has been an anomaly and not been away for long since."""

    def see(self, there: bool, value: float, now: float, on: float, off: float) -> None:
        """Updates the cause: one that has not lasted is gone at once, one that has lasted when it has been away for a while."""
        if there:
            if math.isnan(self.since):
                self.since, self.most = now, 0.0
            self.last, self.most = now, max(self.most, abs(value))
        elif now - self.last > off or not self.holds(on):
            self.since = math.nan

    def holds(self, on: float) -> bool:
        """Whether it has lasted long enough to count."""
        return not math.isnan(self.since) and self.last - self.since >= on

    @property
    def gone(self) -> bool:
        return math.isnan(self.since)


class Anomalies:
    """The states, in the time of the estimates, s."""

    def __init__(self, settings: Settings = Settings()):
        self.settings = settings
        self.state = "starting"
        self.since = math.nan
        self.causes = {name: Cause(name) for name in ("force", "silence", *FAULTS)}
        self.cause = ""
        self.named: dict[str, Any] = {}
        """The twin's newest name for the cause of this anomaly, and its probability."""
        self.last: float = math.nan
        self.begun: float = math.nan
        """Time of the first estimate, or of the first one after a gap."""
        self.gathered = [0.0, 0.0, 0.0]
        """Number of samples and sums of the unknown torques, while calibrating."""

    def see(self, fields: dict[str, float], now: float) -> list[dict[str, Any]]:
        """An estimate; the alarms that it leads to."""
        if math.isnan(self.last):
            # Earlier samples had another clock, perhaps.
            self.causes["silence"] = Cause("silence")
        if math.isnan(self.last) or now < self.last or now - self.last > self.settings.silence:
            self.begun = now
            if self.state in ("starting", "listening"):
                self._go("starting", now)
        self.last = now
        wrong = self._wrong(fields)
        for name in ("force", *FAULTS):
            self.causes[name].see(
                name == wrong, fields.get("estimated.nis", 0.0), now, self.settings.on, self.settings.off
            )
        self.causes["silence"].see(False, 0.0, now, 0.0, 0.0)
        for cause in self.causes.values():
            cause.told &= abs(now - cause.last) <= self.settings.cooling
        if self.state == "anomaly":
            self._name(fields)
        if self.state == "calibrating":
            self.gathered[0] += 1
            for i in (1, 2):
                self.gathered[i] += fields.get(f"estimated.tau[{i}]", 0.0)
        return self._advance(now, fields)

    def never(self, now: float, since: float, samples: int) -> list[dict[str, Any]]:
        """No estimate has ever come, though it should have; times of the samples' clock, s."""
        if self.state != "starting" or now - since <= STARTING + self.settings.silence:
            return []
        self.causes["silence"].see(True, now - since, now, 0.0, 0.0)
        return self._raise("silence", now, {"seconds": now - since, "samples": float(samples)}, {})

    def quiet(self, now: float) -> list[dict[str, Any]]:
        """No estimate so far, at a time of the same clock."""
        if not math.isnan(self.last) and now - self.last > self.settings.silence:
            self.causes["silence"].see(True, now - self.last, now, 0.0, 0.0)
            if not self.causes["silence"].told:
                return self._raise("silence", now, {"seconds": now - self.last}, {})
        return []

    def acknowledge(self, now: float) -> list[dict[str, Any]]:
        """An operator has taken note."""
        if self.state not in ("anomaly", "calibrating"):
            return []
        return [self._go("cooling down", now, reason="acknowledged")]

    def _advance(self, now: float, fields: dict[str, float]) -> list[dict[str, Any]]:
        settings, wrong = self.settings, self._wrong(fields)
        gone = all(cause.gone for cause in self.causes.values())
        if self.state == "starting":
            # A fault need not go before: it may have been there before the first sample.
            if now - self.begun >= STARTING and self.causes["force"].gone:
                self._go("listening", now)
        elif wrong and self._is_news(wrong, now):
            names = FORCE_FIGURES if wrong == "force" else ("estimated.status",)
            return self._raise(wrong, now, {name: fields[name] for name in names if name in fields}, fields)
        elif self.state == "anomaly":
            if gone:
                self.gathered = [0.0, 0.0, 0.0]
                return [self._go("calibrating", now, lasted=now - self.since, most=self.causes[self.cause].most)]
        elif self.state == "calibrating":
            if now - self.since >= settings.calibrating:
                count = max(self.gathered[0], 1.0)
                mean = {f"estimated.tau[{i}]": self.gathered[i] / count for i in (1, 2)}
                return [self._go("cooling down", now, samples=int(self.gathered[0]), mean=mean)]
        elif self.state == "cooling down" and now - self.since >= settings.cooling and gone:
            return [self._go("listening", now)]
        return []

    def _wrong(self, fields: dict[str, float]) -> str:
        """The fault or the force that an estimate tells, or nothing."""
        name = CAUSES[int(fields.get("estimated.cause", 0))]
        return name if name in FAULTS else "force" if fields.get("estimated.alarm", 0.0) != 0.0 else ""

    def _is_news(self, wrong: str, now: float) -> bool:
        """Whether a cause has lasted and is to be told: a force while the watch listens, a fault unless it has been told."""
        cause = self.causes[wrong]
        may = self.state == "listening" if wrong == "force" else now - self.begun >= STARTING and not cause.told
        return may and cause.holds(self.settings.on)

    def _name(self, fields: dict[str, float]) -> None:
        """Takes over the cause that the twin names; the longer it has gone on, the surer it is."""
        if number := int(fields.get("estimated.cause", 0)):
            self.named = {"named": CAUSES[number], "probability": fields["estimated.cause.probability"]}

    def _raise(
        self, cause: str, now: float, figures: dict[str, float], fields: dict[str, float]
    ) -> list[dict[str, Any]]:
        self.cause, self.named = cause, {}
        self.causes[cause].told = True
        self._name(fields)
        return [self._go("anomaly", now, figures=figures)]

    def _go(self, state: str, now: float, **more: Any) -> dict[str, Any]:
        self.state, self.since = state, now
        cause = "fault" if self.cause in FAULTS else self.cause
        told = {"state": state, "cause": cause} | (self.named if state in ("anomaly", "calibrating") else {}) | more
        if state != "anomaly":
            self.named = {}
        return told


class Histogram:
    """Times from 10 µs to 10 s in bins of 2 %, in fixed memory."""

    LOWEST, RATIO = 1e-5, 1.02

    def __init__(self) -> None:
        self.bins = [0] * (math.ceil(math.log(1e6) / math.log(self.RATIO)) + 1)
        self.count = 0

    def add(self, seconds: float) -> None:
        place = math.ceil(math.log(max(seconds, self.LOWEST) / self.LOWEST) / math.log(self.RATIO))
        self.bins[min(place, len(self.bins) - 1)] += 1
        self.count += 1

    def quantile(self, share: float) -> float:
        """The upper edge of the bin in which that share is reached, s; 0 without times."""
        left = share * self.count
        for place, count in enumerate(self.bins):
            left -= count
            if left <= 0 and self.count:
                return self.LOWEST * self.RATIO**place
        return 0.0


class Watch(Worker):
    """The worker; also the subscriber at which the way from sample to estimate is timed."""

    name = "watch"
    kinds = ("meas", "est", "cmd")

    def __init__(self, config: Config):
        super().__init__(config)
        self.anomalies = Anomalies()
        self.latency = Histogram()
        self.order, self.orders = Newest(), Orders()
        self.samples = 0
        self.waiting: tuple[int, int] | None = None
        """Since when an estimate is waited for: on the samples' clock and on this process' own, ns."""
        self.soonest, self.sample = math.inf, -1
        """Seconds from a sample to its estimate, the fewest so far, by two clocks that may differ; time of the newest sample, ns."""
        self.told_behind = -math.inf
        """When it was said last that estimates are behind, ns."""
        self.last_alarm = -1
        self.alarms = 0
        self.estimates = 0
        self.newest: Message | None = None
        self.arrived = 0

    def handle(self, message: Message, payload: bytes, now: int) -> None:
        if message.kind == "meas":
            self.waiting = (message.time, now) if self.samples == 0 else self.waiting
            self.samples += 1
            return
        if message.kind == "cmd":
            self.orders.check(message, now)
            self.orders.taken(message)
            if message.extra["command"] == "acknowledge":
                self._tell(
                    [each | {"order": message.time} for each in self.anomalies.acknowledge(self.anomalies.last)], now
                )
            return
        self.order.admit(message, now)
        self.newest, self.arrived = message, now
        self.estimates += 1
        sample = next((entry[2] for entry in reversed(message.extra.get("inputs", [])) if entry[0] == "meas"), None)
        if isinstance(sample, int):
            self.latency.add(1e-9 * (now - sample))
            self._look_behind(sample, now, message.seq)
        self._tell(self.anomalies.see(message.fields, 1e-9 * message.time), now)

    def _look_behind(self, sample: int, now: int, seq: int) -> None:
        """Tells of estimates that come later and later: messages wait for whoever does not keep up, be it machine, broker or twin."""
        took = 1e-9 * (now - sample)
        # A machine whose clock was set back has another soonest one.
        self.soonest = took if sample < self.sample else min(took, self.soonest)
        self.sample = sample
        behind = took - self.soonest
        if behind > BEHIND and abs(now - self.told_behind) >= 1e9 * AGAIN:
            self.told_behind = now
            self.trouble(
                "behind",
                f"estimates are {behind:.1f} s behind: the samples are not kept up with, or a clock was set",
                now,
                seq,
                every=0.0,
            )

    def tick(self, now: int) -> None:
        if self.newest is not None:
            self._tell(self.anomalies.quiet(1e-9 * (self.newest.time + now - self.arrived)), now)
            return
        # A machine may take its time to begin; one whose samples come is waited for no longer.
        self.waiting = self.waiting or (now + NO_SAMPLE, now)
        since, at = self.waiting
        self._tell(
            self.anomalies.never(1e-9 * (since + now - at) if self.samples else 1e-9 * now, 1e-9 * since, self.samples),
            now,
        )

    def _tell(self, alarms: list[dict[str, Any]], now: int) -> None:
        for alarm in alarms:
            self.alarms += alarm["state"] == "anomaly"
            log.warning("%s", alarm)
            time, seq = (now, 0) if self.newest is None else (self.newest.time, self.newest.seq)
            self.last_alarm = max(time, self.last_alarm + 1) if time > self.last_alarm - JUMPED else time
            self.publish(Message("alarm", "", self.last_alarm, seq, {}, alarm))

    def status(self) -> dict[str, Any]:
        quantiles = {f"p{share}": 1e3 * self.latency.quantile(share / 100) for share in (50, 90, 99)}
        return {
            "samples": self.samples,
            "estimates": self.estimates,
            "alarms": self.alarms,
            "state": self.anomalies.state,
            "latency_ms": quantiles,
        } | {"latency_bins": {str(place): count for place, count in enumerate(self.latency.bins) if count}}


def run(file: Path) -> int:
    return process.serve(Watch(process.read_config(file)))
