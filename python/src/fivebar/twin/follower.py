"""The twin without its process: from messages to estimates. The same setup and inputs give the same bytes, live or replayed.

For each sample, the unit runs to the sample's time, receives the sample and makes one macro step. The unit corrects its state at the
beginning of a step, and its outputs change only in steps: an estimate is for one macro step after its sample. The states before the last
`DEPTH` inputs are kept. For a late sample, the unit goes back to the state before it and repeats all later inputs.
"""

import base64
import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from typing import Any, Final, NamedTuple

from fivebar.errors import UnitError
from fivebar.instance import State, Unit
from fivebar.library import Library
from fivebar.scene_file import OFFSETS
from fivebar.twin import turn
from fivebar.twin.errors import TwinError
from fivebar.twin.messages import INPUTS, MEASURED, SCHEMA, SERVOS, Message
from fivebar.twin.setup import Setup

DEPTH: Final = 20
"""Maximum number of inputs that a late sample may be behind."""

LONGEST_GAP: Final = 5.0
"""Longest gap between samples that the twin bridges by prediction, s; after a longer one it restarts."""

JUMP: Final = 0.5
"""Tolerance between the times and the numbers of two samples, s, because a machine with a software timer is sometimes late. A larger
difference, or a time that goes back, is a jump of the machine's clock."""

NOT_FITTING: Final = (7.0, 8.0)
"""Values of `estimated.status`: inconsistent and rejected."""

LEGS: Final = (1, 2)
RATES: Final = {name: name.replace("theta", "omega") for name in SERVOS}
"""Command for the rate of each commanded angle, by the command of the angle."""

PLANNED: Final = 1024
"""Samples of the plan kept in memory. Forecasts start every few samples, so most of their plan was already used by the forecast before."""

STAMPS: Final = {name: name.replace("theta", "time") for name in MEASURED}
"""Input for the time of each measured angle, by the input of the angle."""

ESTIMATED: Final = tuple(SCHEMA["definitions"]["est"]["properties"]["fields"]["properties"])
"""The fields of `est`, in the order of the schema. A field that the schema names is checked 10 times as fast as any other."""

LEARNED: Final = {
    **{f"estimated.mass[{i}]": f"estimated.mass.sigma[{i}]" for i in (1, 2, 3, 4)},
    "estimated.payload": "estimated.payload.sigma",
    **{f"estimated.viscous[{i}]": f"estimated.viscous.sigma[{i}]" for i in (1, 2, 3, 4, 5)},
    "estimated.friction": "estimated.friction.sigma",
    **{f"estimated.length[{i}]": f"estimated.length.sigma[{i}]" for i in (1, 2, 3, 4, 5)},
    **{f"estimated.offset[{i}]": f"estimated.offset.sigma[{i}]" for i in LEGS},
}
"""Output of each parameter that the unit can learn, and output of its standard deviation, which is 0 if the parameter is known."""

MASSES: Final = tuple(f"link[{i}].{what}" for i in (1, 2, 3, 4) for what in ("mass", "inertia"))
DRY: Final = tuple(f"friction.{what}[{i}]" for what in ("coulomb", "breakaway") for i in (1, 2, 3, 4, 5))


@dataclass(frozen=True)
class Book:
    """The follower's state beside the state of the unit."""

    offset: int
    """Time on the machine's clock at the unit's time 0, ns."""

    time: int
    """Time of the newest sample on the machine's clock, ns."""

    seq: int
    told: dict[str, float]
    """Drive commands at the newest sample, as true angles."""

    on_plan: bool
    """Whether the commands follow the plan of the scene."""

    assembly: int
    turns: dict[str, float] = field(default_factory=dict)
    """Whole turns to add to each reading, by its name, because encoders may count from another turn than the scene."""

    @property
    def clock(self) -> float:
        """Time of the newest sample on the unit's clock, s."""
        return 1e-9 * (self.time - self.offset)


class Stored(NamedTuple):
    """Content of a message `state` or `ahead`."""

    content: bytes
    """State of the unit."""

    clock: float
    """Time of the unit, s."""

    book: Book
    parameters: dict[str, float]


def stored(message: Message) -> Stored:
    """Decodes the state of a twin from a message."""
    extra = message.extra
    try:
        parameters = {str(name): float(value) for name, value in extra["parameters"].items()}
        return Stored(
            base64.b64decode(extra["state"], validate=True), float(extra["clock"]), Book(**extra["book"]), parameters
        )
    except (KeyError, TypeError, ValueError, AttributeError):
        raise TwinError("a stored state does not have the format of this version") from None


class Rider:
    """A unit that follows drive commands."""

    def __init__(self, library: Library, setup: Setup, name: str):
        self.setup = setup
        self.unit = Unit.of(library, name)
        self.plan = lru_cache(PLANNED)(lambda seq: setup.scene.commands_at(seq * setup.period))
        """Drive commands of the scene at a sample number, as true angles. Do not change them."""
        self.known: Callable[[int], dict[str, float]] | None = None
        """Commands of later samples by their numbers, as true angles, if they are known."""

    def hold(self, book: Book) -> None:
        """Sets the commands at the unit's time: the value of each sample, extrapolated with its rate until the next sample."""
        setup, unit = self.setup, self.unit
        passed = max(0, math.floor((unit.time - book.clock) / setup.period + 1e-6))
        since = unit.time - book.clock - passed * setup.period
        commands = book.told
        goes_on = self.known is not None or book.on_plan
        if passed and goes_on:
            commands = (self.known or self.plan)(book.seq + passed)
        values, slopes = {}, {}
        for name, value in commands.items():
            rate = commands.get(RATES[name], 0.0) if name in RATES else 0.0
            if passed and not goes_on:
                # Without a plan, the drives are assumed to stop at the end of the last command.
                value, rate = (0.0 if name.startswith("servo.omega") else value + rate * setup.period), 0.0
            values[name], slopes[name] = value + rate * since, rate
        unit.update(values)
        unit.ramp(slopes)

    def coast(self, book: Book, until: float) -> Iterator[float]:
        """Runs to a time, s, without new samples. Yields the time after each step; a step ends where the next sample would be."""
        while self.unit.time < until - 1e-9:
            passed = math.floor((self.unit.time - book.clock) / self.setup.period + 1e-6)
            following = book.clock + (passed + 1) * self.setup.period
            self.hold(book)
            self.unit.step_to(following if following < until - 1e-9 else until)
            yield self.unit.time


class _Done(NamedTuple):
    """A processed input, and the state before it."""

    message: Message
    book: Book
    state: State


class Follower(Rider):
    """The twin's unit and its book. Pass messages to `meas`, `param` and `restart`, then call `estimate`."""

    def __init__(self, library: Library, setup: Setup):
        if library.guid != setup.guid:
            raise TwinError(f"the unit {library.fmu} has the GUID {library.guid}; {setup.guid} is expected")
        super().__init__(library, setup, "twin")
        self.book: Book | None = None
        self.parameters: dict[str, float] = {}
        """Parameters set by `param`; they survive a restart of the unit."""
        self.inputs: list[list[Any]] = []
        """Inputs since the last estimate: kind, seq, time."""
        self.after = -1
        """Sample number of the last estimate; -1 before the first one."""
        self.failure = ""
        """Reason for the last loss of the unit; the caller clears it."""
        self.begun = ""
        """A sentence if the readings began in another turn than the scene; the caller clears it."""
        self.jumps = 0
        self.previous: Message | None = None
        self.assembly = int(setup.values.get("init.assembly", 1))
        self.done: deque[_Done] = deque()
        self.learns = bool(setup.values.get("estimator.learn.enabled"))

    # --- inputs -----------------------------------------------------------------------------------------------------------------

    def meas(self, message: Message) -> bool:
        """Accepts a sample and returns whether it gets an estimate. Late samples get none, nor do samples from which the unit cannot start."""
        self._note(message)
        if self.book is not None and message.seq <= self.book.seq:
            self._late(message)
            return False
        if self.book is not None and message.seq - self.book.seq > LONGEST_GAP / self.setup.period:
            self._leave(f"no sample for more than {LONGEST_GAP:g} s")
        try:
            if self.book is None:
                self._start(message)
            if self.book is not None:
                self._take(message)
        except UnitError as error:
            self._leave(str(error))
        self.previous = message
        return self.book is not None

    def param(self, message: Message) -> None:
        """Sets tunable parameters that `allowed` has accepted."""
        self._note(message)
        self.parameters = self.parameters | message.fields
        if self.book is not None:
            self._remember(message)
            try:
                self.unit.update(message.fields)
            except UnitError as error:
                self._leave(str(error))

    def restart(self, message: Message) -> None:
        """Restarts the twin at the next sample."""
        self._note(message)
        self._leave("")

    def allowed(self, message: Message) -> str:
        """The reason why the unit does not allow these parameters, or ""."""
        for name, value in message.fields.items():
            variable = self.unit.library.variables.get(name)
            if variable is None or variable.causality != "parameter" or variable.variability != "tunable":
                return f"param {name[:64]!r} is no tunable parameter of the unit"
            if variable.type != "Real":
                return f"param {name} is of type {variable.type}, not Real"
            bounds = variable.declaredType if variable.min is None and variable.max is None else variable
            lowest, highest = (
                None if b is None or b == "" else float(b)
                for b in (getattr(bounds, "min", None), getattr(bounds, "max", None))
            )
            if (lowest is not None and value < lowest) or (highest is not None and value > highest):
                return f"param {name} is {value:g}; {'-inf' if lowest is None else lowest} to {'inf' if highest is None else highest} is allowed"
        return ""

    # --- results ----------------------------------------------------------------------------------------------------------------

    def estimate(self) -> Message:
        """The estimate for one macro step after the newest sample, with the inputs since the last estimate."""
        assert self.book is not None, "an estimate needs a sample"
        fields = {name: value for name, value in self.unit.floats(ESTIMATED).items() if math.isfinite(value)}
        if fields["estimated.status"] not in NOT_FITTING:
            self.assembly = int(fields["mode.assembly"])
        self.book = replace(self.book, assembly=self.assembly)
        extra = {"after": self.after, "inputs": self.inputs}
        self.inputs, self.after = [], self.book.seq
        return Message("est", "", self.book.time + self.setup.step_ns, self.book.seq, fields, extra)

    def state(self) -> Message:
        """The complete state, from which a twin can resume in any process."""
        assert self.book is not None, "a state needs a sample"
        content = base64.b64encode(self.unit.state().to_bytes()).decode("ascii")
        extra = {"state": content, "clock": self.unit.time, "book": asdict(self.book), "parameters": self.parameters}
        return Message("state", "", self.book.time, self.book.seq, {}, extra)

    def learned(self) -> Message | None:
        """Learned values with standard deviations, and the corresponding start values of a unit; None if nothing is learned."""
        assert self.book is not None, "learning needs a sample"
        if not self.learns:
            return None
        seen = self.unit.floats((*LEARNED, *LEARNED.values(), *MASSES, *DRY))
        known = [name for name, sigma in LEARNED.items() if seen[sigma] > 0]
        values: dict[str, float] = {}
        for name in known:
            value, place = seen[name], name[-2:-1]
            if name.startswith("estimated.mass"):
                factor = value / seen[f"link[{place}].mass"]
                values |= {
                    f"link[{place}].mass": value,
                    f"link[{place}].inertia": factor * seen[f"link[{place}].inertia"],
                }
            elif name.startswith("estimated.viscous"):
                values[f"viscous.b[{place}]"] = value
            elif name == "estimated.payload":
                values["payload.mass"] = value
            elif name == "estimated.friction":
                values |= {each: value * seen[each] for each in DRY}
            elif name.startswith("estimated.length"):
                values[f"link[{place}].length" if place != "5" else "base.distance"] = value
            elif name.startswith("estimated.offset"):
                key = OFFSETS[int(place) - 1]
                values[key] = self.setup.scene.offsets.get(key, 0.0) + value
        fields = {each: seen[each] for name in known for each in (name, LEARNED[name])}
        return Message("learned", "", self.book.time + self.setup.step_ns, self.book.seq, fields, {"values": values})

    def go_on_from(self, message: Message) -> None:
        """Resumes from a stored state."""
        content, clock, book, parameters = stored(message)
        self.unit.restore(content, clock)
        self._forget()
        self.book, self.parameters, self.assembly, self.previous = book, parameters, book.assembly, None
        self.after = book.seq
        self.inputs = [["state", message.seq, message.time]]

    # --- inside -----------------------------------------------------------------------------------------------------------------

    def _note(self, message: Message) -> None:
        self.inputs.append([message.kind, message.seq, message.time])

    def _leave(self, why: str) -> None:
        self.failure = why
        self.book = None
        self._forget()

    def _forget(self) -> None:
        self.done.clear()

    def _remember(self, message: Message) -> None:
        assert self.book is not None, "inputs before the start are not kept"
        if len(self.done) == DEPTH:
            self.done.popleft()
        self.done.append(_Done(message, self.book, self.unit.state()))

    def _start(self, message: Message) -> None:
        """Starts at rest, or at the rate between two samples, if this sample has both angles. Servos without commands hold these angles."""
        fields = self.setup.scene.true(message.fields)
        missing = [name for name in MEASURED if name not in fields]
        if missing:
            self.failure = f"a start needs both angles, but {missing[0]} is missing"
            return
        given = self.setup.values | self.parameters
        begins = turn.begins(self.unit.library, given, fields, [fields[name] for name in MEASURED])
        turns = {name: float(begin.turns) for name, begin in zip(MEASURED, begins, strict=True) if begin.turns}
        angles = [fields[name] + turn.TURN * turns.get(name, 0.0) for name in MEASURED]
        values: dict[str, float | int | bool] = {
            f"init.theta[{i}]": angle for i, angle in zip(LEGS, angles, strict=True)
        }
        before = self.previous
        rates = [message.fields.get(f"servo.omega[{i}]", 0.0) for i in LEGS]
        if before is not None and 0 < message.seq - before.seq <= 5 and all(name in before.fields for name in MEASURED):
            span = (message.seq - before.seq) * self.setup.period
            rates = [math.remainder(message.fields[name] - before.fields[name], turn.TURN) / span for name in MEASURED]
        values |= {f"init.omega[{i}]": rate for i, rate in zip(LEGS, rates, strict=True)} | {
            "init.assembly": self.assembly
        }
        held = {f"servo.theta[{i}]": angle for i, angle in zip(LEGS, angles, strict=True)}
        self.unit.reset(**(held | self.setup.values | values | self.parameters))
        self.book = Book(message.time, message.time, message.seq, {}, False, self.assembly, turns)
        self.begun = " and ".join(begin.sentence for begin in begins if begin.turns)

    def _take(self, message: Message) -> None:
        """Processes a sample that is not late."""
        assert self.book is not None, "a sample is only accepted after the start"
        book = self.book
        if message.seq > book.seq:
            self._remember(message)
        expected = round(1e9 * self.setup.period) * (message.seq - book.seq)
        odd = message.time - book.time - expected
        if abs(odd) > 1e9 * JUMP or (message.seq > book.seq and message.time <= book.time):
            # The machine's clock was set: the motion continued for as many periods as the samples count.
            book = replace(book, offset=book.offset + odd)
            self.jumps += 1
        fields = self.setup.scene.true(message.fields)
        commands = {name: value for name, value in fields.items() if name in INPUTS}
        plan = self.plan(message.seq)
        on_plan = commands.keys() == plan.keys() and all(abs(commands[name] - plan[name]) < 1e-6 for name in plan)
        following = replace(book, time=message.time, seq=message.seq, told=commands, on_plan=on_plan)
        for _ in self.coast(self.book, following.clock):
            pass
        seen = [name for name in MEASURED if name in fields]
        self.unit.update(
            {name: fields[name] + turn.TURN * following.turns.get(name, 0.0) for name in seen}
            | {STAMPS[name]: self.unit.time for name in seen}
        )
        self.book = following
        self.hold(following)
        self.unit.step_to(following.clock + self.setup.step)

    def _late(self, message: Message) -> None:
        """Goes back to the state before the sample's time and repeats all later inputs after it."""
        places = [
            i for i, done in enumerate(self.done) if done.message.kind == "meas" and done.message.seq > message.seq
        ]
        if not places:
            return
        again = [message, *(done.message for done in list(self.done)[places[0] :])]
        back = self.done[places[0]]
        self.unit.restore(back.state)
        self.book = back.book
        while len(self.done) > places[0]:
            self.done.pop()
        try:
            for each in again:
                if each.kind == "meas":
                    self._take(each)
                else:
                    self._remember(each)
                    self.unit.update(each.fields)
        except UnitError as error:
            self._leave(str(error))

    def finds_place(self, seq: int) -> bool:
        """Whether the state before a late sample is still available."""
        return any(done.message.kind == "meas" and done.message.seq > seq > done.book.seq for done in self.done)

    def close(self) -> None:
        """Frees the unit."""
        self._forget()
        self.unit.close()
