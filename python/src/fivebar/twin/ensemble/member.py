"""Members of an ensemble, one after the other on an instance of the unit: the work of a worker.

A member is defined by its number: its random values come from its own generator (Philox, keyed with seed and number), so that it is the
same wherever and whenever it runs. It begins from a stored state of the unit. If its start state or parameters that are fixed after the
start differ, the unit restarts at the angles and rates of that state.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from fivebar.errors import UnitError
from fivebar.instance import State, Unit
from fivebar.library import Library
from fivebar.scene_file import OFFSETS
from fivebar.twin.calibrate.parameters import USUAL, Asked, Values, assemble, parameters
from fivebar.twin.errors import TwinError
from fivebar.variables import Value

STATE: Final = ("theta[1]", "theta[2]", "omega[1]", "omega[2]")
"""Start angles and rates; their spreads are in rad and rad/s."""

VARIED: Final = Asked("varied", (*(name for name in USUAL if name not in OFFSETS), *STATE))

SHOWN: Final = ("tip.x", "tip.y", "theta[1]", "theta[2]")
"""Outputs of each member stored at every point in time."""

KINDS: Final = ("none", "direct", "inverse, left", "inverse, right")
"""Kinds of the first singularity, by number."""

PASSES: Final = ("singular.passes.direct", "singular.passes.inverse[1]", "singular.passes.inverse[2]")
HALVINGS: Final = 10
"""Number of bisections of the step with a singularity; they give its time to a thousandth of the step."""

METHOD: Final[Values] = {"solver.method": 6, "solver.maxWork": 20000}
"""Defaults: the method automatic, and a limit of evaluations per ms; a member that spins so fast that it exceeds the limit fails."""


@dataclass(frozen=True)
class Plan:
    """Data common to all members, as plain values that can be sent to workers."""

    values: Values
    """Start values."""

    seconds: float
    points: int
    """Number of evenly spaced points in time from 0 to `seconds`, without 0, at which outputs are stored."""

    seed: int
    spreads: dict[str, float] = field(default_factory=dict)
    """Standard deviations by name: of `STATE`, or of an unknown of a calibration, in its sizes (a factor: 0.01 is 1 %)."""

    names: tuple[str, ...] = ()
    """Inputs with commands."""

    period: float = 0.005
    """Time between two rows of `commands`, s."""

    commands: tuple[tuple[float, ...], ...] = ()
    """Rows of input values, with linear interpolation between them."""

    state: bytes = b""
    """A stored state to start from; empty: start values."""

    clock: float = 0.0
    """Time of that state, s."""


class Runner:
    """An instance that runs members of a plan; `shown` are the stored outputs."""

    def __init__(self, library: Library, plan: Plan, shown: tuple[str, ...] = SHOWN):
        self.library, self.plan = library, plan
        self.unit = Unit.of(library, "member")
        self.of_state = [name for name in plan.spreads if name in STATE]
        self.of_machine = [name for name in plan.spreads if name not in STATE]
        self.values = METHOD | plan.values
        self.sought = parameters(self.of_machine, library, plan.values, VARIED)
        members = [library.variable(member) for parameter in self.sought for member in parameter.members]
        self.tunable = not self.of_state and all(v.variability == "tunable" for v in members) and not self._switches()
        if plan.state:
            self.unit.restore(plan.state, plan.clock)
        else:
            self.unit.reset(**self.values)
        self.base = self.unit.state()
        self.begin = self.unit.floats((*STATE, "mode.assembly"))
        self.shown, self.inputs = shown, library.blocks(plan.names)
        self.times = self._times()

    def _switches(self) -> bool:
        """Whether an uncertain parameter switches an effect on."""
        return any(
            self.values.get(name) != value
            for name, value in assemble(
                self.plan.values, self.library, self.sought, [p.origin for p in self.sought]
            ).items()
            if name.endswith(".enabled")
        )

    def _times(self) -> list[tuple[float, float, bool]]:
        """Steps: begin and end in s after the start, and whether outputs are stored at the end."""
        plan = self.plan
        points = [plan.seconds * k / plan.points for k in range(1, plan.points + 1)]
        if not plan.names:
            return [(a, b, True) for a, b in zip([0.0, *points], points, strict=False)]
        knots = [plan.period * k for k in range(1, math.ceil(plan.seconds / plan.period - 1e-9))]
        every = sorted({round(t, 12) for t in (*points, *knots)})
        ends = {round(t, 12) for t in points}
        return [(a, b, b in ends) for a, b in zip([0.0, *every], every, strict=False)]

    def drawn(self, member: int) -> list[float]:
        """Standard normal random numbers of a member, one per spread."""
        chance = np.random.Generator(np.random.Philox(key=(self.plan.seed << 64) | member))
        return [float(x) for x in chance.standard_normal(len(self.plan.spreads))]

    def start(self, member: int) -> dict[str, float]:
        """Sets up the start of a member; returns its random values."""
        plan, unit = self.plan, self.unit
        offs = {name: sigma * x for (name, sigma), x in zip(plan.spreads.items(), self.drawn(member), strict=True)}
        x = [max(p.origin + offs[name], p.lowest) for p, name in zip(self.sought, self.of_machine, strict=True)]
        unit.restore(self.base)
        if self.tunable:
            changed = assemble(plan.values, self.library, self.sought, x)
            unit.update({name: value for name, value in changed.items() if plan.values.get(name) != value})
        else:
            values = METHOD | assemble(plan.values, self.library, self.sought, x)
            values |= {f"init.{name}": self.begin[name] + offs.get(name, 0.0) for name in STATE}
            if self.begin["mode.assembly"] in (1, 2):
                values["init.assembly"] = int(self.begin["mode.assembly"])
            unit.reset(self.base.time, **(values | self._held(0)))
        return {name: float(number) for name, number in zip(self.of_machine, x, strict=True)} | {
            n: self.begin[n] + offs[n] for n in self.of_state
        }

    def _held(self, row: int) -> Values:
        return dict(zip(self.plan.names, self.plan.commands[row], strict=True)) if self.plan.names else {}

    def run(self, member: int) -> dict[str, Any]:
        """Runs a member; returns its results."""
        plan, unit = self.plan, self.unit
        shown = np.full((plan.points, len(self.shown)), np.nan, dtype=np.float32)
        result: dict[str, Any] = {
            "member": member,
            "failed": "",
            "singular.time": math.nan,
            "singular.kind": 0,
            "shown": shown,
        }
        begin, row = self.base.time, 0
        try:
            result["drawn"] = self.start(member)
            before = unit.numbers(PASSES)
            for now, then, point in self.times:
                self._tell(now, then)
                stored = unit.state() if not result["singular.kind"] else None
                unit.step_to(begin + then)
                if stored is not None:
                    after = unit.numbers(PASSES)
                    if after != before:
                        result |= self._first(stored, before, now, then)
                        unit.restore(stored)
                        self._tell(now, then)
                        unit.step_to(begin + then)
                if point:
                    shown[row] = unit.numbers(self.shown)
                    row += 1
        except UnitError as error:
            result["failed"] = str(error)[:200] or "the unit discarded a call"
            result.setdefault("drawn", {})
        return result

    def _first(self, stored: State, before: list[Value], now: float, then: float) -> dict[str, Any]:
        """Time and kind of the first singularity in a step, by bisection."""
        unit, low, high = self.unit, now, then
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            unit.restore(stored)
            self._tell(now, middle)
            unit.step_to(self.base.time + middle)
            low, high = (low, middle) if unit.numbers(PASSES) != before else (middle, high)
        unit.restore(stored)
        self._tell(now, high)
        unit.step_to(self.base.time + high)
        after = unit.numbers(PASSES)
        kind = next((k for k, (a, b) in enumerate(zip(after, before, strict=True), 1) if a != b), 0)
        return {"singular.time": (low + high) / 2, "singular.kind": kind}

    def _tell(self, now: float, then: float) -> None:
        """Sets the inputs over a step within one interval between rows."""
        if not self.inputs:
            return
        plan = self.plan
        row = min(int(now / plan.period + 1e-9), len(plan.commands) - 1)
        here, there = plan.commands[row], plan.commands[min(row + 1, len(plan.commands) - 1)]
        slopes = [(b - a) / plan.period for a, b in zip(here, there, strict=True)]
        since = now - row * plan.period
        for block in self.inputs:
            self.unit.write(block, [a + s * since for a, s in zip(here, slopes, strict=True)])
            if any(slopes):
                self.unit.write_rates(block, slopes)

    def close(self) -> None:
        """Frees the unit."""
        self.unit.close()


def spreads(given: Mapping[str, str]) -> dict[str, float]:
    """Parses standard deviations such as `5%` and `0.05`."""
    found = {}
    for name, text in given.items():
        try:
            value = float(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value >= 0):
            raise TwinError(f"the spread of {name} is {text!r:.40}; a standard deviation is expected, as 2% or 0.02")
        found[name] = value
    return found
