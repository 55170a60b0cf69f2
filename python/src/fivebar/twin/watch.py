"""The watch process: monitors the estimates and reports each anomaly once, with cause and figures.

It has the states of the Incubator's supervisor: listening → anomaly → calibrating → cooling down → listening. A cause counts only after
it has lasted for a while, and ends only after it has been absent for a while. Nothing counts while the twin converges. A cause is present
if the unit's alarm is on, or if the unit names an encoder or the clocks. An encoder fault during another anomaly is reported immediately as
its own anomaly; a permanent fault is reported once.
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
"""Names of the values of `estimated.cause`, in order."""

FAULTS: Final = ("encoder 1", "encoder 2", "timing")
"""`CAUSES` that count even without the unit's alarm, which is for forces only."""

FORCE_FIGURES: Final = (
    "estimated.nis",
    "estimated.tau[1]",
    "estimated.tau[2]",
    "estimated.tau.sigma[1]",
    "estimated.tau.sigma[2]",
)
"""Fields reported with a force; for a fault it is the status."""

STARTING: Final = 2.0
"""Time without alarms after the first estimate or after a gap, s."""

NO_SAMPLE: Final = 30_000_000_000
"""Time without any sample that leads to an alarm, ns."""

JUMPED: Final = 10_000_000_000
"""If a time is earlier by more than this, it is from another clock, ns."""

BEHIND: Final = 1.0
"""Allowed increase of the delay from sample to estimate over its minimum, s; beyond it, something does not keep up."""

log = logging.getLogger("fivebar")


@dataclass(frozen=True)
class Settings:
    """Times in s."""

    on: float = 0.04
    """Time for which a cause must last to be an anomaly."""

    off: float = 0.5
    """Time for which the cause must be absent to end the anomaly."""

    calibrating: float = 2.0
    """Duration of the samples gathered for a calibration afterwards."""

    cooling: float = 5.0
    """Time without further force alarms. A fault, or silence, that returns within this time is not reported again."""

    silence: float = 0.5
    """Time without estimates that leads to an alarm."""


@dataclass
class Cause:
    """A possible cause of an anomaly, with hysteresis in time."""

    name: str
    since: float = math.nan
    """Time of its begin; NaN while absent."""

    last: float = -math.inf
    most: float = 0.0
    reported: bool = False
    """Whether it was reported as an anomaly and has not been absent for long since."""

    def see(self, there: bool, value: float, now: float, on: float, off: float) -> None:
        """Updates the cause. A short cause ends immediately, a lasting one only after it has been absent for `off`."""
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
    """State machine of the watch, in the time of the estimates, s."""

    def __init__(self, settings: Settings = Settings()):
        self.settings = settings
        self.state = "starting"
        self.since = math.nan
        self.causes = {name: Cause(name) for name in ("force", "silence", *FAULTS)}
        self.cause = ""
        self.named: dict[str, Any] = {}
        """Newest cause of this anomaly according to the twin, and its probability."""
        self.last: float = math.nan
        self.begun: float = math.nan
        """Time of the first estimate, or of the first one after a gap, s."""
        self.gathered = [0.0, 0.0, 0.0]
        """Number of samples and sums of the unknown torques during calibration."""

    def see(self, fields: dict[str, float], now: float) -> list[dict[str, Any]]:
        """Takes an estimate; returns the resulting alarms."""
        if math.isnan(self.last):
            # Earlier samples may have had another clock.
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
            cause.reported &= abs(now - cause.last) <= self.settings.cooling
        if self.state == "anomaly":
            self._name(fields)
        if self.state == "calibrating":
            self.gathered[0] += 1
            for i in (1, 2):
                self.gathered[i] += fields.get(f"estimated.tau[{i}]", 0.0)
        return self._advance(now, fields)

    def never(self, now: float, since: float, samples: int) -> list[dict[str, Any]]:
        """Alarms if no estimate has ever arrived; times on the clock of the samples, s."""
        if self.state != "starting" or now - since <= STARTING + self.settings.silence:
            return []
        self.causes["silence"].see(True, now - since, now, 0.0, 0.0)
        return self._raise("silence", now, {"seconds": now - since, "samples": float(samples)}, {})

    def quiet(self, now: float) -> list[dict[str, Any]]:
        """Alarms if estimates have stopped; `now` is on the same clock, s."""
        if not math.isnan(self.last) and now - self.last > self.settings.silence:
            self.causes["silence"].see(True, now - self.last, now, 0.0, 0.0)
            if not self.causes["silence"].reported:
                return self._raise("silence", now, {"seconds": now - self.last}, {})
        return []

    def acknowledge(self, now: float) -> list[dict[str, Any]]:
        """Handles an operator's acknowledgement."""
        if self.state not in ("anomaly", "calibrating"):
            return []
        return [self._go("cooling down", now, reason="acknowledged")]

    def _advance(self, now: float, fields: dict[str, float]) -> list[dict[str, Any]]:
        settings, wrong = self.settings, self._wrong(fields)
        gone = all(cause.gone for cause in self.causes.values())
        if self.state == "starting":
            # A fault may be present before the first sample, so that it need not be absent first.
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
        """The fault or force reported by an estimate, or ""."""
        name = CAUSES[int(fields.get("estimated.cause", 0))]
        return name if name in FAULTS else "force" if fields.get("estimated.alarm", 0.0) != 0.0 else ""

    def _is_news(self, wrong: str, now: float) -> bool:
        """Whether to report a lasting cause: a force while the watch listens, a fault unless it was reported before."""
        cause = self.causes[wrong]
        may = self.state == "listening" if wrong == "force" else now - self.begun >= STARTING and not cause.reported
        return may and cause.holds(self.settings.on)

    def _name(self, fields: dict[str, float]) -> None:
        """Stores the cause that the twin names; it becomes more certain over time."""
        if number := int(fields.get("estimated.cause", 0)):
            self.named = {"named": CAUSES[number], "probability": fields["estimated.cause.probability"]}

    def _raise(
        self, cause: str, now: float, figures: dict[str, float], fields: dict[str, float]
    ) -> list[dict[str, Any]]:
        self.cause, self.named = cause, {}
        self.causes[cause].reported = True
        self._name(fields)
        return [self._go("anomaly", now, figures=figures)]

    def _go(self, state: str, now: float, **more: Any) -> dict[str, Any]:
        self.state, self.since = state, now
        cause = "fault" if self.cause in FAULTS else self.cause
        content = {"state": state, "cause": cause} | (self.named if state in ("anomaly", "calibrating") else {}) | more
        if state != "anomaly":
            self.named = {}
        return content


class Histogram:
    """Histogram of times from 10 µs to 10 s in bins of 2 %, with fixed memory."""

    LOWEST, RATIO = 1e-5, 1.02

    def __init__(self) -> None:
        self.bins = [0] * (math.ceil(math.log(1e6) / math.log(self.RATIO)) + 1)
        self.count = 0

    def add(self, seconds: float) -> None:
        place = math.ceil(math.log(max(seconds, self.LOWEST) / self.LOWEST) / math.log(self.RATIO))
        self.bins[min(place, len(self.bins) - 1)] += 1
        self.count += 1

    def quantile(self, share: float) -> float:
        """Upper edge of the bin at a quantile, s; 0 without times."""
        left = share * self.count
        for place, count in enumerate(self.bins):
            left -= count
            if left <= 0 and self.count:
                return self.LOWEST * self.RATIO**place
        return 0.0


class Watch(Worker):
    """The worker; it also measures the latency from sample to estimate at a subscriber."""

    name = "watch"
    kinds = ("meas", "est", "cmd")

    def __init__(self, config: Config):
        super().__init__(config)
        self.anomalies = Anomalies()
        self.latency = Histogram()
        self.order, self.orders = Newest(), Orders()
        self.samples = 0
        self.waiting: tuple[int, int] | None = None
        """Begin of the wait for an estimate: on the clock of the samples and on this process' clock, ns."""
        self.soonest, self.sample = math.inf, -1
        """Minimum delay from sample to estimate, s, between two clocks that may differ; time of the newest sample, ns."""
        self.told_behind = -math.inf
        """Time of the last report that estimates are behind, ns."""
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
        """Reports growing delays of the estimates: machine, broker or twin does not keep up."""
        took = 1e-9 * (now - sample)
        # After the machine's clock was set back, the minimum starts again.
        self.soonest = took if sample < self.sample else min(took, self.soonest)
        self.sample = sample
        behind = took - self.soonest
        if behind > BEHIND and abs(now - self.told_behind) >= 1e9 * AGAIN:
            self.told_behind = now
            self.trouble(
                "behind",
                f"estimates are {behind:.1f} s behind: a process does not keep up with the samples, or a clock was set",
                now,
                seq,
                every=0.0,
            )

    def tick(self, now: int) -> None:
        if self.newest is not None:
            self._tell(self.anomalies.quiet(1e-9 * (self.newest.time + now - self.arrived)), now)
            return
        # A machine may start late, but once its samples arrive, so must estimates.
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
