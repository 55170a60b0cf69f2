"""Which samples the twin takes: new ones, and late ones that still find their place; all others are refused with a sentence.

A series of samples counts on. A machine that begins to count anew is believed after `CONSISTENT` samples that follow each other, all
of them newer than everything that was taken: one forged sample cannot end a series, and old ones sent again never begin one.
"""

from dataclasses import dataclass
from typing import Final, Literal

from fivebar_twin.errors import Refused
from fivebar_twin.messages import Message

CONSISTENT: Final = 20
LONGEST_LEAP: Final = 20
"""Samples that may be missing where the times do not say so too."""


@dataclass
class _Series:
    seq: int
    time: int
    length: int = 1


class Intake:
    """Remembers where the series is. `admit` says what a sample is; `taken` are those of the last `window` that came."""

    def __init__(self, period: float, window: int = 64):
        self.period_ns = round(1e9 * period)
        self.window = window
        self.series: _Series | None = None
        self.candidate: _Series | None = None
        self.newest_time = -1
        self.came: set[int] = set()
        self.missing = 0
        """Samples of the series that never came, so far as one can tell: a late one counts back."""

    def admit(self, message: Message) -> Literal["new", "late", "series"]:
        """What the sample is; `Refused` if it is not to be taken."""
        if self.series is None:
            self._begin(message)
            return "series"
        ahead = message.seq - self.series.seq
        if ahead <= 0:
            return self._behind(message, ahead)
        if not self._plausible(self.series, message):
            return self._else(message, f"meas {message.seq} leaps by {ahead} samples and {1e-9 * (message.time - self.series.time):.3f} s")
        self.missing += ahead - 1
        self._step(message)
        return "new"

    def go_on_from(self, seq: int, time: int) -> None:
        """Goes on after that sample, which an earlier life of this process took."""
        self.series, self.newest_time = _Series(seq, time), time
        self.came = {seq}

    def _plausible(self, series: _Series, message: Message) -> bool:
        """Few samples later, whatever the clocks show, or as many later as the clocks say."""
        ahead = message.seq - series.seq
        odd = abs(message.time - series.time - ahead * self.period_ns)
        return 0 < ahead <= LONGEST_LEAP or (ahead > 0 and odd <= max(self.period_ns, ahead * self.period_ns // 4))

    def _behind(self, message: Message, ahead: int) -> Literal["late", "series"]:
        if message.seq in self.came:
            if message.time > self.newest_time:
                return self._else(message, f"meas {message.seq} was taken already")
            raise Refused(f"meas {message.seq} was taken already")
        if -ahead < self.window and message.time <= self.newest_time:
            self.came.add(message.seq)
            self.missing -= 1
            return "late"
        return self._else(message, f"meas {message.seq} is older than {self.series.seq if self.series else 0}, the newest, by {-ahead} samples")

    def _else(self, message: Message, sentence: str) -> Literal["series"]:
        """The sample does not belong to the series: perhaps to another one, which is to show first."""
        if message.time <= self.newest_time:
            raise Refused(sentence)
        candidate = self.candidate
        if candidate is not None and message.seq == candidate.seq + 1 and 0 < message.time - candidate.time <= 2 * self.period_ns:
            self.candidate = _Series(message.seq, message.time, candidate.length + 1)
        else:
            self.candidate = _Series(message.seq, message.time)
        if self.candidate.length < CONSISTENT:
            raise Refused(sentence)
        self._begin(message)
        return "series"

    def _begin(self, message: Message) -> None:
        self.series, self.candidate, self.newest_time = _Series(message.seq, message.time), None, message.time
        self.came = {message.seq}

    def _step(self, message: Message) -> None:
        self.series, self.candidate, self.newest_time = _Series(message.seq, message.time), None, max(self.newest_time, message.time)
        self.came.add(message.seq)
        if len(self.came) > 2 * self.window:
            self.came = {seq for seq in self.came if message.seq - seq <= self.window}
