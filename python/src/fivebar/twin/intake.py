"""Intake of samples: the twin takes new ones, and late ones that still find their place; all others are refused with a sentence.

A series of samples counts on, whatever its clock does. A machine that begins to count anew is believed after `CONSISTENT` samples that
follow each other, newer than those that were taken, at times near the pipeline's own or near where the series' clock would be by now: one
forged sample cannot end a series, and old ones sent again begin none. What is remembered against these follows the machine's clock where
it jumps, and is bounded: a time of another clock, however late, keeps nothing out, and a series that has been silent for `FORGOTTEN` is
none any more.

Times must be in ns: a series whose times are, or go on, as those of a longer unit would is never believed.
"""

from dataclasses import dataclass
from typing import Final, Literal

from fivebar.twin import units
from fivebar.twin.errors import Refused
from fivebar.twin.messages import Message

CONSISTENT: Final = 20
NEAR: Final = 10_000_000_000
"""Nanoseconds by which two clocks may differ that show the same time."""

FORGOTTEN: Final = 60_000_000_000
"""Nanoseconds of silence after which a series no longer says which times are plausible."""

YEAR: Final = 31_557_600_000_000_000
"""Nanoseconds by which a clock may be off if its times are to be recognised in another unit."""

QUIET: Final = 1_000_000_000
"""Nanoseconds without a newer message after which an older one of the pipeline itself is taken."""

LONGEST_LEAP: Final = 20
"""Samples that may be missing where the times do not say so too."""

LASTING: Final = 1_000_000_000
"""Nanoseconds after which refused samples, with none taken, are reported: longer than it takes to believe a machine."""


@dataclass
class _Series:
    seq: int
    time: int
    length: int = 1
    first: int = 0
    """Time of its first sample, ns."""


class Intake:
    """Remembers where the series is. `admit` classifies a sample; `taken` are those of the last `window` that came."""

    def __init__(self, period: float, window: int = 64):
        self.period_ns = round(1e9 * period)
        self.window = window
        self.series: _Series | None = None
        self.candidate: _Series | None = None
        self.newest_time = -1
        self.arrived = 0
        """When the newest sample of the series came, on the pipeline's clock, ns."""
        self.came: set[int] = set()
        self.missing = 0
        """Samples of the series that never came, so far as one can tell: a late one counts back."""

    def admit(self, message: Message, now: int) -> Literal["new", "late", "series"]:
        """Class of a sample that came at `now` of the pipeline's clock, ns; `Refused` if it is not to be taken."""
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
                f"meas {message.seq} leaps by {ahead} samples and {1e-9 * (message.time - self.series.time):.3f} s",
                now,
            )
        self.missing += ahead - 1
        self._step(message, now)
        return "new"

    def forget(self) -> None:
        """The next sample begins a series, whatever was before: an operator has asked for it."""
        self.series, self.candidate, self.newest_time = None, None, -1

    def go_on_from(self, seq: int, time: int) -> None:
        """Goes on after that sample, which an earlier life of this process took."""
        self.series, self.newest_time, self.arrived = _Series(seq, time), time, time
        self.came = {seq}

    def _plausible(self, series: _Series, message: Message) -> bool:
        """Few samples later, whatever the clocks show, or as many later as the clocks say."""
        ahead = message.seq - series.seq
        odd = abs(message.time - series.time - ahead * self.period_ns)
        return 0 < ahead <= LONGEST_LEAP or (ahead > 0 and odd <= max(self.period_ns, ahead * self.period_ns // 4))

    def _behind(self, message: Message, ahead: int, now: int) -> Literal["late", "series"]:
        if message.seq in self.came:
            return self._else(message, f"meas {message.seq} was taken already", now)
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
        """Whether a new series may have a sample of that time."""
        if self.series is None:
            return True
        silent = now - self.arrived
        if silent > FORGOTTEN:
            return True
        own = abs(message.time - now) <= NEAR
        if own and self.newest_time > now + NEAR:
            # The newest is of another clock, and says nothing about this one.
            return True
        return (own or abs(message.time - self.series.time - silent) <= NEAR) and message.time > self.newest_time

    def _else(self, message: Message, sentence: str, now: int) -> Literal["series"]:
        """The sample does not belong to the series: perhaps to another one, which is to show first."""
        if not self._may_begin(message, now):
            raise Refused(sentence)
        candidate = self.candidate
        if candidate is not None and (message.seq, message.time) == (candidate.seq, candidate.time):
            # A doubled sample does not end the candidate's series.
            raise Refused(sentence)
        if (
            candidate is not None
            and message.seq == candidate.seq + 1
            and 0 < message.time - candidate.time <= 2 * self.period_ns
        ):
            self.candidate = _Series(message.seq, message.time, candidate.length + 1, candidate.first)
            step = (message.time - candidate.first) / candidate.length
            # A machine that is timed by software may send a few samples too fast.
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
        # A clock that was set back far is followed: its earlier times count no more.
        followed = self.newest_time > max(now, message.time) + NEAR
        self.newest_time = message.time if followed else max(self.newest_time, message.time)
        self.came.add(message.seq)
        if len(self.came) > 2 * self.window:
            self.came = {seq for seq in self.came if message.seq - seq <= self.window}


class Newest:
    """The newest message of the pipeline itself: messages older by number and time are refused, until no newer one has come for a while."""

    def __init__(self) -> None:
        self.newest: tuple[int, int] | None = None
        self.arrived = 0

    def admit(self, message: Message, now: int) -> None:
        """Takes note of a message that came at a time of the pipeline's clock, ns; `Refused` if it is an old one."""
        if self.newest is not None and now - self.arrived < QUIET:
            seq, time = self.newest
            if message.seq <= seq and message.time <= time:
                raise Refused(f"{message.kind} {message.seq} is not newer than {seq}, which came before")
        self.newest, self.arrived = (message.seq, message.time), now


class Orders:
    """Intake of orders: each must be newer than the last one, and given at a time near the pipeline's own."""

    def __init__(self) -> None:
        self.newest = -1

    def check(self, message: Message, now: int) -> None:
        """`Refused` if the order is not to be taken at that time of the pipeline's clock, ns."""
        if abs(message.time - now) > NEAR:
            raise Refused(
                f"{_elsewhen(message, now)}; up to {1e-9 * NEAR:g} s are allowed: set the clock from which the order comes"
            )
        if message.time <= self.newest:
            by = 1e-9 * (self.newest - message.time)
            raise Refused(
                f"{message.kind} is not newer than the last order that was taken, but {by:.3f} s older: its clock, or the other's, is wrong"
            )

    def taken(self, message: Message) -> None:
        """The order was carried out."""
        self.newest = message.time


class Refusals:
    """Samples that are refused for `LASTING` or longer while none is taken: how many, and why."""

    def __init__(self) -> None:
        self.count = 0
        """Samples refused in all such spans."""
        self.first = ""
        """The reason in the first span."""
        self._refused, self._counted = 0, 0
        """Samples refused since one was taken, and how many of them `count` includes."""
        self._since = 0
        """When the first of them came, ns."""
        self._reported = 0
        """When `lasting` last returned a sentence, ns."""
        self._reason = ""

    def add(self, why: str, now: int) -> None:
        """A sample was refused at a time of the pipeline's clock, ns."""
        if not self._refused:
            self._since = now
        # A question about the unit explains more than the first sentence about times that are far away.
        if not self._refused or ("?" in why and "?" not in self._reason):
            self._reason = why
        self._refused += 1

    def taken(self) -> None:
        """A sample was taken."""
        self._refused, self._counted = 0, 0

    def lasting(self, now: int) -> str:
        """A sentence, at most once in `LASTING`, if no sample has been taken for that long; else ""."""
        if self._refused == self._counted or now - self._since < LASTING:
            return ""
        self.count += self._refused - self._counted
        self._counted = self._refused
        self.first = self.first or self._reason
        if now - self._reported < LASTING:
            return ""
        self._reported = now
        return f"no sample is taken, {self._refused} are refused, the first because: {self._reason}"


def _elsewhen(message: Message, now: int) -> str:
    """Sentence about a message whose time is not near the pipeline's own."""
    what = message.kind if message.kind != "meas" else f"meas {message.seq}"
    if unit := units.of_time(message.time, now - YEAR, now + YEAR):
        return units.asks_by_time(what, message.time, unit)
    apart = f"{1e-9 * abs(message.time - now):.3f} s {'ahead of' if message.time > now else 'behind'}"
    return f"{what} is from a time that is {apart} the pipeline's own"
