"""Intake of samples: accepts new samples and samples that are not too late, and refuses all others with a reason.

A series is identified by its sample numbers, even if its clock jumps. A machine that restarts its count is accepted after `CONSISTENT`
consecutive samples. They must be newer than all accepted samples, with times near the pipeline's clock or near the extrapolated clock of
the series. So one forged sample cannot end a series, and repeated old samples cannot start one. The time limit against old samples follows
jumps of the machine's clock and is bounded: a time of another clock, however late, blocks nothing. A series without samples for
`FORGOTTEN` is forgotten.

Times must be in ns: a series is never accepted if its times or its time steps look like a longer unit.
"""

from dataclasses import dataclass
from typing import Final, Literal

from fivebar.twin import units
from fivebar.twin.errors import Refused
from fivebar.twin.messages import Message

CONSISTENT: Final = 20
NEAR: Final = 10_000_000_000
"""Allowed difference between two synchronised clocks, ns."""

FORGOTTEN: Final = 60_000_000_000
"""Time without samples after which the times of a series are forgotten, ns."""

YEAR: Final = 31_557_600_000_000_000
"""Maximum clock error with which times in a wrong unit are recognised, ns."""

QUIET: Final = 1_000_000_000
"""Time without a newer message after which older messages of the pipeline itself are accepted, ns."""

LONGEST_LEAP: Final = 20
"""Maximum number of missing samples that the times need not confirm."""

LASTING: Final = 1_000_000_000
"""Time with only refused samples after which they are reported, ns: longer than the acceptance of a machine takes."""


@dataclass
class _Series:
    seq: int
    time: int
    length: int = 1
    first: int = 0
    """Time of the first sample, ns."""


class Intake:
    """State of the series. `admit` classifies a sample, which may be late by less than `window` samples."""

    def __init__(self, period: float, window: int = 64):
        self.period_ns = round(1e9 * period)
        self.window = window
        self.series: _Series | None = None
        self.candidate: _Series | None = None
        self.newest_time = -1
        self.arrived = 0
        """Arrival of the newest sample of the series on the pipeline's clock, ns."""
        self.came: set[int] = set()
        self.missing = 0
        """Number of samples of the series missing so far; a late sample reduces it."""

    def admit(self, message: Message, now: int) -> Literal["new", "late", "series"]:
        """Classifies a sample that arrived at `now` on the pipeline's clock, ns. Raises `Refused` if it is not accepted."""
        if unit := units.of_time(message.time, now - NEAR, now + NEAR):
            raise Refused(units.asks_by_time(f"meas {message.seq}", message.time, unit))
        if self.series is None:
            if abs(message.time - now) > NEAR:
                return self._else(message, _elsewhen(message, now), now)
            self._begin(message, now)
            return "series"
        ahead = message.seq - self.series.seq
        if ahead <= 0:
            return self._behind(message, ahead, now)
        if not self._plausible(self.series, message):
            return self._else(
                message,
                f"meas {message.seq} jumps by {ahead} samples and {1e-9 * (message.time - self.series.time):.3f} s",
                now,
            )
        self.missing += ahead - 1
        self._step(message, now)
        return "new"

    def forget(self) -> None:
        """Lets the next sample begin a series in any case, at an operator's request."""
        self.series, self.candidate, self.newest_time = None, None, -1

    def go_on_from(self, seq: int, time: int) -> None:
        """Resumes after a sample that this process accepted before its restart."""
        self.series, self.newest_time, self.arrived = _Series(seq, time), time, time
        self.came = {seq}

    def _plausible(self, series: _Series, message: Message) -> bool:
        """Whether a sample is few samples later at any time, or as many samples later as its time says."""
        ahead = message.seq - series.seq
        odd = abs(message.time - series.time - ahead * self.period_ns)
        return 0 < ahead <= LONGEST_LEAP or (ahead > 0 and odd <= max(self.period_ns, ahead * self.period_ns // 4))

    def _behind(self, message: Message, ahead: int, now: int) -> Literal["late", "series"]:
        if message.seq in self.came:
            return self._else(message, f"meas {message.seq} has been accepted already", now)
        if -ahead < self.window and message.time <= self.newest_time:
            self.came.add(message.seq)
            self.missing -= 1
            return "late"
        return self._else(
            message,
            f"meas {message.seq} is older than {self.series.seq if self.series else 0}, the newest, by {-ahead} samples",
            now,
        )

    def _may_begin(self, message: Message, now: int) -> bool:
        """Whether a new series may contain a sample with this time."""
        if self.series is None:
            return True
        silent = now - self.arrived
        if silent > FORGOTTEN:
            return True
        own = abs(message.time - now) <= NEAR
        if own and self.newest_time > now + NEAR:
            # The newest time is from another clock, so it does not limit this series.
            return True
        return (own or abs(message.time - self.series.time - silent) <= NEAR) and message.time > self.newest_time

    def _else(self, message: Message, sentence: str, now: int) -> Literal["series"]:
        """Handles a sample outside the series: it may belong to a new series, which must first be confirmed."""
        if not self._may_begin(message, now):
            raise Refused(sentence)
        candidate = self.candidate
        if candidate is not None and (message.seq, message.time) == (candidate.seq, candidate.time):
            # A duplicate does not end the candidate series.
            raise Refused(sentence)
        if (
            candidate is not None
            and message.seq == candidate.seq + 1
            and 0 < message.time - candidate.time <= 2 * self.period_ns
        ):
            self.candidate = _Series(message.seq, message.time, candidate.length + 1, candidate.first)
            step = (message.time - candidate.first) / candidate.length
            # A machine with a software timer may send a few samples too fast.
            if self.candidate.length >= CONSISTENT // 2 and (unit := units.of_step(step, self.period_ns)):
                expected = f"{1e-9 * self.period_ns:g} s"
                raise Refused(f"meas {message.seq}: {units.asks_by_step(1e-9 * step, expected, unit.name)}")
        else:
            self.candidate = _Series(message.seq, message.time, first=message.time)
        if self.candidate.length < CONSISTENT:
            raise Refused(sentence)
        self._begin(message, now)
        return "series"

    def _begin(self, message: Message, now: int) -> None:
        self.series, self.candidate, self.newest_time, self.arrived = (
            _Series(message.seq, message.time),
            None,
            message.time,
            now,
        )
        self.came = {message.seq}

    def _step(self, message: Message, now: int) -> None:
        self.series, self.candidate, self.arrived = _Series(message.seq, message.time), None, now
        # Times from before the clock was set far back no longer count.
        followed = self.newest_time > max(now, message.time) + NEAR
        self.newest_time = message.time if followed else max(self.newest_time, message.time)
        self.came.add(message.seq)
        if len(self.came) > 2 * self.window:
            self.came = {seq for seq in self.came if message.seq - seq <= self.window}


class Newest:
    """The newest message of the pipeline itself. A message with both an older number and an older time is refused, unless none arrived for `QUIET`."""

    def __init__(self) -> None:
        self.newest: tuple[int, int] | None = None
        self.arrived = 0

    def admit(self, message: Message, now: int) -> None:
        """Accepts a message that arrived at `now` on the pipeline's clock, ns. Raises `Refused` for an old message."""
        if self.newest is not None and now - self.arrived < QUIET:
            seq, time = self.newest
            if message.seq <= seq and message.time <= time:
                raise Refused(f"{message.kind} {message.seq} is not newer than {seq}, which came before")
        self.newest, self.arrived = (message.seq, message.time), now


class Orders:
    """Intake of commands and parameters: each must be newer than the last one, with a time near the pipeline's clock."""

    def __init__(self) -> None:
        self.newest = -1

    def check(self, message: Message, now: int) -> None:
        """Raises `Refused` if a command is not accepted at `now` on the pipeline's clock, ns."""
        if abs(message.time - now) > NEAR:
            raise Refused(
                f"{_elsewhen(message, now)}; up to {1e-9 * NEAR:g} s are allowed: set the clock of the sender"
            )
        if message.time <= self.newest:
            by = 1e-9 * (self.newest - message.time)
            raise Refused(
                f"{message.kind} is not newer than the last accepted command, but {by:.3f} s older: the clock of one of the senders is wrong"
            )

    def taken(self, message: Message) -> None:
        """Marks a command as executed."""
        self.newest = message.time


class Refusals:
    """Number of samples, and reason, in spans of `LASTING` or longer with only refused samples."""

    def __init__(self) -> None:
        self.count = 0
        """Number of refused samples in all such spans."""
        self.first = ""
        """Reason in the first span."""
        self._refused, self._counted = 0, 0
        """Number of refused samples since the last accepted one, and how many of them `count` includes."""
        self._since = 0
        """Arrival of the first of them, ns."""
        self._reported = 0
        """Time of the last sentence from `lasting`, ns."""
        self._reason = ""

    def add(self, why: str, now: int) -> None:
        """Counts a sample that was refused at `now` on the pipeline's clock, ns."""
        if not self._refused:
            self._since = now
        # A question about the unit of time explains more than a sentence about distant times.
        if not self._refused or ("?" in why and "?" not in self._reason):
            self._reason = why
        self._refused += 1

    def taken(self) -> None:
        """Restarts the count after an accepted sample."""
        self._refused, self._counted = 0, 0

    def lasting(self, now: int) -> str:
        """A sentence if no sample was accepted for `LASTING`, at most once per `LASTING`; else ""."""
        if self._refused == self._counted or now - self._since < LASTING:
            return ""
        self.count += self._refused - self._counted
        self._counted = self._refused
        self.first = self.first or self._reason
        if now - self._reported < LASTING:
            return ""
        self._reported = now
        return f"no sample is accepted: {self._refused} are refused, the first because: {self._reason}"


def _elsewhen(message: Message, now: int) -> str:
    """Sentence about a message with a time far from the pipeline's clock."""
    what = message.kind if message.kind != "meas" else f"meas {message.seq}"
    if unit := units.of_time(message.time, now - YEAR, now + YEAR):
        return units.asks_by_time(what, message.time, unit)
    apart = f"{1e-9 * abs(message.time - now):.3f} s {'ahead of' if message.time > now else 'behind'}"
    return f"{what} is from a time that is {apart} the pipeline's own"
