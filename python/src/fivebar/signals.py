"""Time-varying inputs and tunable parameters, given by a few knots [time in s, value].

- `{"linear": [[t, v], ...]}` interpolates linearly between the knots.
- `{"minimumJerk": [[t, v], ...]}` rests in each knot and moves to the next by 10u³ − 15u⁴ + 6u⁵, the motion of least mean square
  jerk between two rests (Flash and Hogan, J. Neurosci. 5 (1985) 1688, eq. 3).
- `{"steps": [[t, v], ...]}` keeps the value of each knot until the next. Tunable parameters allow only this kind.
- `{"rateOf": "servo.theta[1]"}` is the derivative of another signal.

Before its first and after its last knot a signal is constant.
"""

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from fivebar.errors import FiveBarError
from fivebar.variables import Variable, Variables, shown

TIP = ("tip.x", "tip.y")
"""Outputs that may have signals although they are computed: servos move the tip along them (`fivebar.tip_scenes`)."""

LINEAR, MINIMUM_JERK, RATE_OF, STEPS = KINDS = ("linear", "minimumJerk", "rateOf", "steps")

EARLY = 1e-9
"""Lead of a step, s: times that a master adds up differ from written times by round-off."""


@dataclass(frozen=True)
class Signal:
    """The course of one variable through its knots, or the derivative of such a course."""

    variable: Variable
    kind: str
    """`linear`, `minimumJerk` or `steps`."""

    knots: tuple[tuple[float, float], ...]
    """Times, s, and values."""

    end: float
    """Time of the last knot as written in the file, s."""

    rate: bool = False

    def at(self, time: float) -> float:
        """The value at a time, s. The crate `scenes` has the same order of operations, so both give the same bits."""
        segment = min(max(bisect_right(self.knots, time, key=lambda knot: knot[0]) - 1, 0), len(self.knots) - 2)
        (start, before), (end, after) = self.knots[segment], self.knots[segment + 1]
        duration, change = end - start, after - before
        u = (time - start) / duration
        if not self.rate:
            return before + change * self._way(min(max(u, 0.0), 1.0))
        return change / duration * self._slope(u) if 0.0 <= u < 1.0 else 0.0

    def _way(self, u: float) -> float:
        """Interpolation from 0 to 1 for u from 0 to 1."""
        if self.kind == LINEAR:
            return u
        if self.kind == STEPS:
            return 0.0 if u < 1.0 else 1.0
        bend = 10.0 - 15.0 * u + 6.0 * u * u
        return u * u * u * bend

    def _slope(self, u: float) -> float:
        """Derivative of the interpolation; steps have none."""
        if self.kind == LINEAR:
            return 1.0
        left = 1.0 - u
        return 30.0 * u * u * left * left


def read(given: Any, variables: Variables) -> list[Signal]:
    """The signals of a file."""
    if given is None:
        return []
    if not isinstance(given, dict):
        raise FiveBarError(f"'signals' must be an object of names and signals, not {shown(given)}")
    found = []
    for name in given:
        try:
            found.append(_signal(given, name, variables))
        except FiveBarError as error:
            raise FiveBarError(f"signal '{name}': {error}") from None
    return found


def written(found: Mapping[str, Signal]) -> dict[str, Any]:
    """The signals by name as in a file. A rate is left out if the signal that it is the derivative of is not there."""
    knots = {
        name: {signal.kind: [[time + (EARLY if signal.kind == STEPS else 0.0), value] for time, value in signal.knots]}
        for name, signal in found.items()
        if not signal.rate
    }
    rates = {}
    for name, signal in found.items():
        for source in knots:
            unit = f"{found[source].variable.unit}/s"
            if signal.rate and found[source].knots == signal.knots and signal.variable.unit == unit:
                rates[name] = {RATE_OF: source}
    return knots | rates


def may_move(variable: Variable) -> bool:
    """Whether a variable may have a signal."""
    return variable.name in TIP or variable.causality == "input" or _takes_steps(variable)


def _takes_steps(variable: Variable) -> bool:
    return variable.type == "Real" and variable.variability == "tunable"


def _signal(given: Mapping[str, Any], name: str, variables: Variables) -> Signal:
    kind, value = _kind(given[name])
    variable = variables.get(name)
    if name in TIP:
        variable = variables[name]
    elif kind != STEPS or variable is None or not _takes_steps(variable):
        variable = variables.input(name)
    if kind == RATE_OF:
        source = _source(given, value, variables)
        if source is None or source.kind == STEPS or variable.unit != f"{source.variable.unit}/s":
            raise FiveBarError(
                f"'{RATE_OF}' must name a signal with knots whose rate has the unit {variable.unit}, not {shown(value)}"
            )
        return replace(source, variable=variable, rate=True)
    if not (isinstance(value, list) and len(value) > 1 and all(_is_knot(knot) for knot in value)):
        raise FiveBarError(f"'{kind}' must be a list of two or more knots [time in s, value], not {shown(value)}")
    knots = [(float(time), float(v)) for time, v in value]
    for (before, _), (after, _) in pairwise(knots):
        if after <= before:
            raise FiveBarError(f"the knots' times must increase, but {_short(after)} s follows {_short(before)} s")
    for (begin, before), (end, after) in pairwise(knots):
        if not math.isfinite((after - before) / (end - begin)):
            raise FiveBarError(f"the way between the knots at {_short(begin)} s and {_short(end)} s is too steep")
    early = EARLY if kind == STEPS else 0.0
    return Signal(variable, kind, tuple((time - early, v) for time, v in knots), knots[-1][0])


def _source(given: Mapping[str, Any], name: Any, variables: Variables) -> Signal | None:
    """The signal to differentiate, or None if it has no knots. A rate of a rate is refused, so there are no cycles."""
    if not isinstance(name, str) or name not in given:
        return None
    try:
        if _kind(given[name])[0] == RATE_OF:
            return None
    except FiveBarError:
        return None
    return _signal(given, name, variables)


def _kind(given: Any) -> tuple[str, Any]:
    """The only key of a signal, and its value."""
    if isinstance(given, dict) and len(given) == 1:
        [(kind, value)] = given.items()
        if kind in KINDS:
            return kind, value
    raise FiveBarError(f"it must be an object with one key, one of {', '.join(KINDS)}, not {shown(given)}")


def _is_knot(knot: Any) -> bool:
    return (
        isinstance(knot, list)
        and len(knot) == 2
        and all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in knot)
    )


def _short(number: float) -> str:
    return repr(number).removesuffix(".0")
