"""Units of time that are taken for others: what is asked of whoever sends such times."""

from typing import Final, NamedTuple

FIRST, LAST = 1e17, 2.0**63
"""ns since 1970: the years 1973 and 2262. No number is a time between them in two units."""


class Unit(NamedTuple):
    """A unit of time, longer than ns."""

    name: str
    ns: int


LONGER: Final = (Unit("microseconds", 10**3), Unit("milliseconds", 10**6), Unit("seconds", 10**9))


def of_time(time: float, first: float = FIRST, last: float = LAST) -> Unit | None:
    """The longer unit in which a number is a time between two others, ns, if there is one."""
    return next((unit for unit in LONGER if first <= time * unit.ns < last), None)


def of_step(step: float, period: float) -> Unit | None:
    """The longer unit in which a step of the time, taken as ns, is near a period; both in the same unit. None if it is as it should be.

    Half-way between two units, by ratio, the next one is nearer: a machine that is sampled up to thirty times too fast is only that.
    """
    return next((unit for unit in reversed(LONGER) if step * unit.ns < period * 1000**0.5), None)


def asks_by_time(what: str, time: float, unit: Unit) -> str:
    """Sentence about a time since 1970."""
    return f"time of {what} is {time}, and ns since 1970 are expected: are these {unit.name}?"


def asks_by_step(step: float, expected: str, unit: str) -> str:
    """Sentence about times whose steps, s, are those of another unit."""
    return f"time goes on by {step:g} s a sample; {expected} is expected: are these {unit}?"
