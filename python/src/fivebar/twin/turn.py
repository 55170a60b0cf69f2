"""The initial turn of each axis: encoders may count from another turn than the scene, but servos, springs and stops depend on the turn."""

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from fivebar.library import Library
from fivebar.variables import Value

TURN: Final = 2 * math.pi


class Begin(NamedTuple):
    """Initial turn of an axis."""

    turns: int
    """Whole turns to add to the reading."""

    sentence: str
    """Sentence about a change of turn; "" without one."""


def begins(
    library: Library, values: Mapping[str, Value], commands: Mapping[str, float], angles: Sequence[float]
) -> list[Begin]:
    """For each axis, the turn nearest to its command; without a command, nearest to its spring, the middle of its stops, or its start in the scene.

    `commands` and `angles` (one per encoder) are true angles, rad; an angle of NaN gets no turn. Start values missing in `values` are the unit's defaults.
    """
    found = []
    for i, angle in enumerate(angles, 1):
        name, reference = _reference(library, values, commands, i)
        turns = 0 if math.isnan(angle) else round((reference - angle) / TURN)
        sentence = (
            f"measured.theta[{i}] begins at {angle:g} rad and is taken as {angle + TURN * turns:g} rad, "
            f"in the turn nearest to {name} = {reference:g} rad"
        )
        found.append(Begin(turns, sentence if turns else ""))
    return found


def _reference(
    library: Library, values: Mapping[str, Value], commands: Mapping[str, float], i: int
) -> tuple[str, float]:
    """Name and value, rad, of the angle that determines the turn of axis `i`."""

    known = {**library.known.start, **values}

    def value(name: str) -> float:
        return float(known[name])

    servo, spring, lower, upper = (
        f"{name}[{i}]" for name in ("servo.theta", "spring.theta0", "stop.lower", "stop.upper")
    )
    if known["servo.enabled"] and value(f"servo.kp[{i}]") > 0 and (servo in commands or servo in values):
        return servo, float(commands.get(servo, value(servo)))
    if known["spring.enabled"] and value(f"spring.k[{i}]") > 0:
        return spring, value(spring)
    # Stops more than a turn apart allow several turns.
    if known["stop.enabled"] and value(upper) - value(lower) <= TURN:
        return f"the middle of {lower} and {upper}", 0.5 * (value(lower) + value(upper))
    return f"init.theta[{i}]", value(f"init.theta[{i}]")
