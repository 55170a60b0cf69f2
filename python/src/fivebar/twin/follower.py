"""The twin without its surroundings: from messages to estimates. The same setup and inputs give the same bytes, live or replayed.

Every sample moves the unit to the sample's time, hands it over, and takes one macro step, for the unit corrects at the beginning of a
step and its outputs change in steps only: an estimate is for one macro step after its sample. Late samples go where they belong: the
states before the last `DEPTH` inputs are kept, and what came after a late sample is done again.
"""

import base64
import math
from collections import deque
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final, NamedTuple

from fivebar.errors import UnitError
from fivebar.instance import State, Unit
from fivebar.library import Library
from fivebar.scene_file import OFFSETS
from fivebar.twin import turn
from fivebar.twin.errors import TwinError
from fivebar.twin.messages import INPUTS, MEASURED, Message
from fivebar.twin.setup import Setup

DEPTH: Final = 20
"""Inputs after which a late sample still finds its place."""

LONGEST_GAP: Final = 5.0
"""Seconds without a sample after which the twin starts anew instead of coasting."""

JUMP: Final = 0.5
"""Seconds by which times and numbers of two samples may differ: a machine that is timed by software is late now and then. More, or a
time that goes back, is a jump of the machine's clock."""

NOT_FITTING: Final = (7.0, 8.0)
"""Values of `estimated.status`: inconsistent and rejected."""

LEGS: Final = (1, 2)
STAMPS: Final = {name: name.replace("theta", "time") for name in MEASURED}
"""Inputs that have the times of the samples, by the inputs of these."""

ESTIMATED: Final = (
    *(f"{name}[{i}]" for name in ("theta", "omega", "passive.theta") for i in LEGS),
    *("tip.x", "tip.y", "tip.vx", "tip.vy", "tip.ax", "tip.ay", "mode.assembly"),
    *(f"estimated.{name}.sigma[{i}]" for name in ("theta", "omega") for i in LEGS),
    *(f"estimated.tip.cov[{i}]" for i in (1, 2, 3)),
    *(f"estimated.{name}[{i}]" for name in ("tau", "tau.sigma", "innovation") for i in LEGS),
    *("estimated.nis", "estimated.alarm", "estimated.status", "estimated.cause", "estimated.cause.probability"),
)
"""The fields of `est`."""

LEARNED: Final = {
    **{f"estimated.mass[{i}]": f"estimated.mass.sigma[{i}]" for i in (1, 2, 3, 4)},
    "estimated.payload": "estimated.payload.sigma",
    **{f"estimated.viscous[{i}]": f"estimated.viscous.sigma[{i}]" for i in (1, 2, 3, 4, 5)},
    "estimated.friction": "estimated.friction.sigma",
    **{f"estimated.length[{i}]": f"estimated.length.sigma[{i}]" for i in (1, 2, 3, 4, 5)},
    **{f"estimated.offset[{i}]": f"estimated.offset.sigma[{i}]" for i in LEGS},
}
"""Names of all that a unit may learn, and of its standard deviation, which is 0 where it is taken as known."""

MASSES: Final = tuple(f"link[{i}].{what}" for i in (1, 2, 3, 4) for what in ("mass", "inertia"))
DRY: Final = tuple(f"friction.{what}[{i}]" for what in ("coulomb", "breakaway") for i in (1, 2, 3, 4, 5))


@dataclass(frozen=True)
class Book:
    """State of following beside the unit's own state."""

    offset: int
    """Reading of the machine's clock at the unit's time 0, ns."""

    time: int
    """Of the newest sample, on the machine's clock, ns."""

    seq: int
    told: dict[str, float]
    """Commands of the drives at the newest sample, by true angles."""

    on_plan: bool
    """Whether the commands are those of the plan."""

    assembly: int
    turns: dict[str, float] = field(default_factory=dict)
    """Whole turns to be added to each reading, by its name: encoders may count from another turn than the scene."""

    @property
    def clock(self) -> float:
        """The newest sample's time on the unit's clock, s."""
        return 1e-9 * (self.time - self.offset)


class Stored(NamedTuple):
    """Content of a message `state` or `ahead`."""

    content: bytes
    """The unit's own."""

    clock: float
    """Of the unit, s."""

    book: Book
    parameters: dict[str, float]


def stored(message: Message) -> Stored:
    """Everything from which the twin can go on, from a message."""
    extra = message.extra
    try:
        parameters = {str(name): float(value) for name, value in extra["parameters"].items()}
        return Stored(
            base64.b64decode(extra["state"], validate=True), float(extra["clock"]), Book(**extra["book"]), parameters
        )
    except (KeyError, TypeError, ValueError, AttributeError):
        raise TwinError("a stored state is not as this version writes it") from None


class Rider:
    """A unit that is led along the commands of its drives."""

    def __init__(self, library: Library, setup: Setup, name: str):
        self.setup = setup
        self.unit = Unit.of(library, name)

    def hold(self, book: Book) -> None:
        """Sets the commands at the unit's time: each sample's value, going on at its rate to the next sample."""
        setup, unit = self.setup, self.unit
        passed = max(0, math.floor((unit.time - book.clock) / setup.period + 1e-6))
        since = unit.time - book.clock - passed * setup.period
        told = book.told
        if passed and book.on_plan:
            told = setup.scene.told((book.seq + passed) * setup.period)
        values, slopes = {}, {}
        for name, value in told.items():
            rate = told.get(name.replace("theta", "omega"), 0.0) if name.startswith("servo.theta") else 0.0
            if passed and not book.on_plan:
                # Nobody knows how it goes on: the drives stop where the last order has led them.
                value, rate = (0.0 if name.startswith("servo.omega") else value + rate * setup.period), 0.0
            values[name], slopes[name] = value + rate * since, rate
        unit.update(values)
        unit.ramp(slopes)

    def coast(self, book: Book, until: float) -> None:
        """Goes to a time without new samples, s."""
        while self.unit.time < until - 1e-9:
            passed = math.floor((self.unit.time - book.clock) / self.setup.period + 1e-6)
            following = book.clock + (passed + 1) * self.setup.period
            self.hold(book)
            self.unit.step_to(following if following < until - 1e-9 else until)


class _Done(NamedTuple):
    """An input, and the state before it."""

    message: Message
    book: Book
    state: State


class Follower(Rider):
    """The twin's unit and its book. Feed it with `meas`, `param` and `restart`; then `estimate`."""

    def __init__(self, library: Library, setup: Setup):
        if library.guid != setup.guid:
            raise TwinError(f"the unit {library.fmu} has the GUID {library.guid}; {setup.guid} is expected")
        super().__init__(library, setup, "twin")
        self.book: Book | None = None
        self.parameters: dict[str, float] = {}
        """Set by `param`, and kept when the unit starts anew."""
        self.inputs: list[list[Any]] = []
        """Messages taken since the last estimate: kind, seq, time."""
        self.after = -1
        """The sample of the last estimate; -1 before the first."""
        self.failure = ""
        """Why the unit had to be left, since the last look."""
        self.begun = ""
        """A sentence, if the readings began in another turn; since the last look."""
        self.jumps = 0
        self.previous: Message | None = None
        self.assembly = int(setup.values.get("init.assembly", 1))
        self.done: deque[_Done] = deque()
        self.learns = bool(setup.values.get("estimator.learn.enabled"))

    # --- inputs -----------------------------------------------------------------------------------------------------------------

    def meas(self, message: Message) -> bool:
        """Takes a sample; whether there is an estimate for it (there is none for a late one, or one that no start is made of)."""
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
        """Sets tunable parameters, which `allowed` has looked at."""
        self._note(message)
        self.parameters = self.parameters | message.fields
        if self.book is not None:
            self._remember(message)
            try:
                self.unit.update(message.fields)
            except UnitError as error:
                self._leave(str(error))

    def restart(self, message: Message) -> None:
        """Starts anew with the next sample."""
        self._note(message)
        self._leave("")

    def allowed(self, message: Message) -> str:
        """Why the unit does not allow those parameters, or ""."""
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
        """The estimate, one macro step after the newest sample, and the inputs that it is made of."""
        assert self.book is not None, "there is an estimate after a sample only"
        fields = {name: value for name, value in self.unit.floats(ESTIMATED).items() if math.isfinite(value)}
        if fields["estimated.status"] not in NOT_FITTING:
            self.assembly = int(fields["mode.assembly"])
        self.book = replace(self.book, assembly=self.assembly)
        extra = {"after": self.after, "inputs": self.inputs}
        self.inputs, self.after = [], self.book.seq
        return Message("est", "", self.book.time + self.setup.step_ns, self.book.seq, fields, extra)

    def state(self) -> Message:
        """Everything from which the twin can go on, in this process or another one."""
        assert self.book is not None, "there is a state after a sample only"
        content = base64.b64encode(self.unit.state().to_bytes()).decode("ascii")
        extra = {"state": content, "clock": self.unit.time, "book": asdict(self.book), "parameters": self.parameters}
        return Message("state", "", self.book.time, self.book.seq, {}, extra)

    def learned(self) -> Message | None:
        """Learned values with standard deviations, and the start values of a unit like that; None where nothing is learned."""
        assert self.book is not None, "something is learned after a sample only"
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
        """Goes on from a stored state."""
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
        assert self.book is not None, "what is before the start is not kept"
        if len(self.done) == DEPTH:
            self.done.popleft()
        self.done.append(_Done(message, self.book, self.unit.state()))

    def _start(self, message: Message) -> None:
        """Starts at rest, or at the rate between two samples, if this sample has both angles. Servos that are told nothing hold there."""
        fields = self.setup.scene.true(message.fields)
        missing = [name for name in MEASURED if name not in fields]
        if missing:
            self.failure = f"a start needs both angles, and {missing[0]} is missing"
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
        """A sample in its order."""
        assert self.book is not None, "a sample is taken after the start only"
        book = self.book
        if message.seq > book.seq:
            self._remember(message)
        expected = round(1e9 * self.setup.period) * (message.seq - book.seq)
        odd = message.time - book.time - expected
        if abs(odd) > 1e9 * JUMP or (message.seq > book.seq and message.time <= book.time):
            # The machine's clock was set: motion went on by as many samples as were counted.
            book = replace(book, offset=book.offset + odd)
            self.jumps += 1
        fields = self.setup.scene.true(message.fields)
        told = {name: value for name, value in fields.items() if name in INPUTS}
        plan = self.setup.scene.told(message.seq * self.setup.period)
        on_plan = told.keys() == plan.keys() and all(abs(told[name] - plan[name]) < 1e-6 for name in plan)
        following = replace(book, time=message.time, seq=message.seq, told=told, on_plan=on_plan)
        self.coast(self.book, following.clock)
        seen = [name for name in MEASURED if name in fields]
        self.unit.update(
            {name: fields[name] + turn.TURN * following.turns.get(name, 0.0) for name in seen}
            | {STAMPS[name]: self.unit.time for name in seen}
        )
        self.book = following
        self.hold(following)
        self.unit.step_to(following.clock + self.setup.step)

    def _late(self, message: Message) -> None:
        """Goes back to the sample's time, and forward again over all later inputs."""
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
        """Whether a sample that comes late can still be put where it belongs."""
        return any(done.message.kind == "meas" and done.message.seq > seq > done.book.seq for done in self.done)

    def close(self) -> None:
        """Frees the unit."""
        self._forget()
        self.unit.close()
