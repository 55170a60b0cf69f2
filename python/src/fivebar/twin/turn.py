"""The turn in which a machine begins: encoders may count from another turn than the scene, but servos, springs and stops depend on the turn."""

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from fivebar.library import Library
from fivebar.variables import Value

TURN: Final = 2 * math.pi


class Begin(NamedTuple):
    """Where an axis begins."""

    turns: int
    """To be added to the reading."""

    sentence: str
    """Reports a change of turn; "" without one."""


def begins(
    library: Library, values: Mapping[str, Value], commands: Mapping[str, float], angles: Sequence[float]
) -> list[Begin]:
    """For each axis, the turn nearest to its command, else to its spring, the middle of its stops, or the start of its scene.

    `commands` and `angles` (one for each encoder) are true angles, rad; an angle that is NaN gets no turn. Start values that `values` lacks are the unit's.
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
    """Name and value, rad, of the angle that decides the turn of axis `i`."""

    def value(name: str) -> float:
        return float(values.get(name, library.variable(name).start))

    def enabled(effect: str) -> bool:
        name = f"{effect}.enabled"
        # FMPy gives the start of a Boolean as its text.
        return bool(values.get(name, library.variable(name).start == "true"))

    servo, spring, lower, upper = (
        f"{name}[{i}]" for name in ("servo.theta", "spring.theta0", "stop.lower", "stop.upper")
    )
    if enabled("servo") and value(f"servo.kp[{i}]") > 0 and (servo in commands or servo in values):
        return servo, float(commands.get(servo, value(servo)))
    if enabled("spring") and value(f"spring.k[{i}]") > 0:
        return spring, value(spring)
    # Stops that are further apart than a turn allow several turns.
    if enabled("stop") and value(upper) - value(lower) <= TURN:
        return f"the middle of {lower} and {upper}", 0.5 * (value(lower) + value(upper))
    return f"init.theta[{i}]", value(f"init.theta[{i}]")
