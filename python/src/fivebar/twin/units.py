"""Times in a wrong unit: detects the probable unit and asks about it. For `meas`, recordings and records."""

from typing import Final, NamedTuple

FIRST, LAST = 1e17, 2.0**63
"""Range of plausible times, ns since 1970: from 1973 to 2262. No number is in this range in two units."""


class Unit(NamedTuple):
    """A unit of time, longer than ns."""

    name: str
    ns: int


LONGER: Final = (Unit("microseconds", 10**3), Unit("milliseconds", 10**6), Unit("seconds", 10**9))

SHORTER: Final = {"ms": ("milliseconds", 1e-3), "us": ("microseconds", 1e-6), "ns": ("nanoseconds", 1e-9)}
"""Units shorter than s as a map writes them: name, and length in s."""


def of_time(time: float, first: float = FIRST, last: float = LAST) -> Unit | None:
    """The unit longer than ns in which a number is a time from `first` to `last`, ns; None if there is none."""
    return next((unit for unit in LONGER if first <= time * unit.ns < last), None)


def of_step(step: float, period: float) -> Unit | None:
    """The unit longer than ns of times that increase by `step` instead of the expected `period`, both in ns; None if they are in ns.

    The limit is the geometric mean of two units: a machine may be sampled up to 30 times faster than expected.
    """
    return next((unit for unit in reversed(LONGER) if step * unit.ns < period * 1000**0.5), None)


def of_long_step(step: float, longest: float) -> str:
    """The longest unit, a key of `SHORTER`, in which times that increase by `step` per sample stay below `longest` s; "" if they are in s."""
    if step < longest:
        return ""
    return next((name for name, (_, factor) in SHORTER.items() if factor * step < longest), "ns")


def asks_by_time(what: str, time: float, unit: Unit) -> str:
    """Question about a time since 1970."""
    return f"time of {what} is {time}, but ns since 1970 are expected: are these {unit.name}?"


def asks_by_step(step: float, expected: str, unit: str) -> str:
    """Question about times with an implausible step, s."""
    return f"time goes on by {step:g} s a sample; {expected} is expected: are these {unit}?"
