"""`fivebar replay FILE`: recomputes the estimates of a record from its samples and compares them bit by bit."""

import math
import time
from collections import deque
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from fivebar.library import Library
from fivebar.twin import record
from fivebar.twin.errors import Refused, TwinError
from fivebar.twin.follower import Follower
from fivebar.twin.messages import Message, decode, encode
from fivebar.twin.setup import of_message

KEPT: Final = 20_000
"""Maximum number of inputs kept until an estimate names them."""

PATIENCE: Final = 500
"""Number of messages after which an input that an estimate names counts as missing."""

MOST_SHOWN: Final = 5
"""Maximum number of differences, gaps and invalid rows that are shown."""

MOSTLY_LEFT_OUT: Final = 3
"""Exit code if all compared estimates agree, but more are left out than compared."""


@dataclass
class Result:
    """Result of a replay."""

    compared: int = 0
    differing: list[str] = field(default_factory=list)
    left_out: int = 0
    """Number of estimates without their inputs in the record, up to the next stored state."""

    not_asked: int = 0
    """Number of estimates before `since`."""

    gaps: list[str] = field(default_factory=list)
    """Gaps reported by the recorder."""

    bad: list[str] = field(default_factory=list)
    """Reasons why rows are not valid messages."""

    states: int = 0
    seconds: float = 0.0
    """CPU time, s, which other load on the machine does not change."""

    spanned: float = 0.0
    """Replayed time on the machine's clock, s."""


class Replay:
    """Replays the messages of a record in order."""

    def __init__(self, follower: Follower):
        self.follower = follower
        self.inputs: dict[tuple[str, int, int], Message] = {}
        self.result = Result()
        self.seen = 0
        self.waiting: deque[tuple[int, Message, bytes]] = deque()
        self.lost = True
        """Whether the twin's state is unknown, until a start or a stored state."""

    def see(self, message: Message, payload: bytes) -> None:
        """Takes the next message of the record."""
        self.seen += 1
        if message.kind in ("meas", "param", "cmd", "state"):
            # Of two inputs with the same number, the twin used the first.
            self.inputs.setdefault((message.kind, message.seq, message.time), message)
            while len(self.inputs) > KEPT:
                del self.inputs[next(iter(self.inputs))]
        if message.kind in ("est", "state"):
            self.waiting.append((self.seen, message, payload))
        self._go_on()

    def end(self) -> None:
        """Finishes after the last message."""
        self.seen += PATIENCE
        self._go_on()

    def _go_on(self) -> None:
        """Continues as far as the inputs reach; a broker may deliver an estimate before its sample."""
        while self.waiting:
            since, message, payload = self.waiting[0]
            here = message.kind == "state" or all(self._given(*one) is not None for one in message.extra["inputs"])
            if not here and self.seen - since < PATIENCE:
                return
            self.waiting.popleft()
            if message.kind == "state":
                self._state(message, payload)
            else:
                self._estimate(message, payload)

    def _given(self, kind: str, seq: int, time: int) -> Message | None:
        """An input; None if it has not arrived."""
        given = self.inputs.get((kind, seq, time))
        if given is None and kind == "cmd" and ("meas", seq, time) in self.inputs:
            # The twin itself decided that the machine restarted its count at this sample.
            return Message("cmd", "", time, seq, {})
        return given

    def _state(self, message: Message, payload: bytes) -> None:
        book = self.follower.book
        if self.lost:
            self.follower.go_on_from(message)
            self.follower.inputs = []
            self.lost = False
        elif book is not None and book.seq == message.seq:
            self.result.states += 1
            if encode(replace(self.follower.state(), unit=message.unit)) != payload:
                self._differs(f"the state after sample {message.seq} differs")

    def _estimate(self, message: Message, payload: bytes) -> None:
        taken = message.extra["inputs"]
        # If an estimate is missing in the record, its inputs are unknown.
        self.lost = self.lost or message.extra.get("after") != self.follower.after
        begins = bool(taken) and (taken[0][0] == "state" or (self.lost and self.first(taken)))
        if self.lost and not begins:
            self.result.left_out += 1
            return
        for kind, seq, at in taken:
            given = self._given(kind, seq, at)
            if given is None:
                self.lost = True
                self.result.left_out += 1
                return
            if kind == "meas":
                self.follower.meas(given)
            elif kind == "param":
                self.follower.param(given)
            elif kind == "cmd":
                self.follower.restart(given)
            elif kind == "state":
                self.follower.go_on_from(given)
            else:
                raise TwinError(f"estimate {message.seq} has an input of the kind {kind[:20]!r}")
        self.lost = False
        self.result.compared += 1
        if self.follower.book is None or encode(replace(self.follower.estimate(), unit=message.unit)) != payload:
            self._differs(f"the estimate after sample {message.seq} differs")

    def first(self, taken: list[list[object]]) -> bool:
        """Whether these are the first inputs after a start of the twin."""
        return self.result.compared == 0 and self.result.left_out == 0 and taken[0][0] in ("meas", "param", "cmd")

    def _differs(self, sentence: str) -> None:
        self.result.differing.append(sentence)


def replay(file: Path, fmu: Path, since: float = -math.inf, until: float = math.inf) -> Result:
    """Recomputes the estimates of a record; `since` and `until` are seconds after its first message."""
    setup = of_message(record.setup(file))
    library = Library(fmu)
    follower = Follower(library, setup)
    try:
        work = Replay(follower)
        begin, first, last, passed = time.process_time(), None, 0, 0.0
        for row in record.rows(file):
            kind = row.topic.rpartition("/")[2]
            if kind not in ("meas", "est", "param", "cmd", "state", "gap"):
                continue
            first = row.time if first is None else first
            passed = 1e-9 * (row.time - first)
            if not since <= passed <= until:
                # A replay from the middle needs a stored state.
                work.result.not_asked += kind == "est" and passed < since
                continue
            try:
                message = decode(row.topic, row.payload)
            except Refused as error:
                work.result.bad.append(str(error))
                continue
            last = max(last, row.time)
            if kind == "gap":
                work.result.gaps.append(gap(message))
            else:
                work.see(message, row.payload)
        if not last:
            raise TwinError(f"nothing was recorded from {since:g} s to {until:g} s; the record is {passed:.3g} s long")
        work.end()
        work.result.seconds = time.process_time() - begin
        work.result.spanned = 1e-9 * (last - (first or 0))
        return work.result
    finally:
        follower.close()
        library.close()


def gap(message: Message) -> str:
    """Description of a gap."""
    why = message.extra.get("why")
    return f"{message.extra['of']} {message.fields['first']:.0f} to {message.fields['last']:.0f}" + (
        f" ({why})" if why else ""
    )


def run(file: Path, fmu: Path, since: float, until: float) -> int:
    """Returns 0 if all estimates agree bit by bit, 1 if one differs or none could be compared, `MOSTLY_LEFT_OUT` if more were left out than compared."""
    result = replay(file, fmu, since, until)
    for what, sentences in (
        ("", result.differing),
        ("the record lacks ", result.gaps),
        ("a row is no message: ", result.bad),
    ):
        for sentence in sentences[:MOST_SHOWN]:
            print(what + sentence)
        if len(sentences) > MOST_SHOWN:
            print(f"... and {len(sentences) - MOST_SHOWN} more")
    speed = result.spanned / result.seconds if result.seconds else 0.0
    print(
        f"{result.compared} estimates and {result.states} stored states compared to the bit in {result.seconds:.2f} s of CPU time "
        f"({speed:.1f} x real time): {len(result.differing)} differ; {result.left_out} left out, because the record lacks their inputs"
    )
    if result.differing or not result.compared:
        return 1
    return MOSTLY_LEFT_OUT if result.left_out > result.compared else 0
