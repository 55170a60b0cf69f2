"""The turn in which a machine begins: its encoders may count from elsewhere than its scene, but servos, springs and stops act by the turn."""

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from fivebar.twin.unit import Library, Values

TURN: Final = 2 * math.pi


class Begin(NamedTuple):
    """Where an axis begins."""

    turns: int
    """To be added to the reading."""

    sentence: str
    """About a reading of another turn, or ""."""


def begins(library: Library, values: Values, commands: Mapping[str, float], angles: Sequence[float]) -> list[Begin]:
    """The turns nearest to where the machine is commanded, else to its spring, its stops, or the start of its scene.

    `commands` and `angles`, of both encoders, are true angles, rad; one that is NaN stays. Start values that `values` lacks are the unit's.
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


def _reference(library: Library, values: Values, commands: Mapping[str, float], i: int) -> tuple[str, float]:
    """Name and value, rad, of the angle that tells the turn of an axis."""

    def value(name: str) -> float:
        return float(values.get(name, library.variable(name).start))

    servo, spring, lower, upper = (
        f"{name}[{i}]" for name in ("servo.theta", "spring.theta0", "stop.lower", "stop.upper")
    )
    if values.get("servo.enabled") and value(f"servo.kp[{i}]") > 0 and (servo in commands or servo in values):
        return servo, float(commands.get(servo, value(servo)))
    if values.get("spring.enabled") and value(f"spring.k[{i}]") > 0:
        return spring, value(spring)
    # Stops that are further apart than a turn allow several.
    if values.get("stop.enabled") and value(upper) - value(lower) <= TURN:
        return f"the middle of {lower} and {upper}", 0.5 * (value(lower) + value(upper))
    return f"init.theta[{i}]", value(f"init.theta[{i}]")
