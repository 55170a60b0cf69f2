"""Checks of a machine's start values: whether the mass of each link can lie between its joints, and whether units look mistaken.

If the mass lies between the joints, the centre of mass c lies between the joints at 0 and l too. The inertia of the mass m about c is largest if all
mass is at the joints: m c (l - c).
"""

import math
from collections.abc import Mapping

from fivebar.variables import Value

MOST_TURNS = 4
"""Start angles beyond are taken for degrees: few starts count so many turns, and few angles of a machine are below 25 degrees."""

LONGEST = 10.0
"""Lengths beyond, m, are taken for millimetres: no link of a machine is shorter than 10 mm or longer than 10 m."""

ANGLES = (
    "init.theta[1]", "init.theta[2]", "servo.theta[1]", "servo.theta[2]", "spring.theta0[1]", "spring.theta0[2]", "gravity.tilt",
    "gravity.direction",
)  # fmt: skip
"""Angles of a start. Stops may be anywhere far away."""

LENGTHS = ("base.distance", *(f"link[{i}].length" for i in (1, 2, 3, 4)))


def doubts(values: Mapping[str, Value]) -> list[str]:
    """Sentences on links whose mass cannot lie between their joints; `values` are all start values of a machine."""
    found = []
    for link in (f"link[{i}]" for i in (1, 2, 3, 4)):
        length, mass, com, inertia = (float(values[f"{link}.{name}"]) for name in ("length", "mass", "com", "inertia"))
        if not 0.0 <= com <= length:
            found.append(
                f"{link}.com is {com:g} m, beyond the joints of a link of {length:g} m: do both values belong to the same link?"
            )
        # A rod with its mass at both ends meets the bound exactly: the factor allows for rounding.
        elif inertia > (most := mass * com * (length - com)) * (1 + 1e-9):
            found.append(
                f"{link}.inertia is {inertia:g} kg.m2 about the centre of mass, more than the {most:.3g} kg.m2 that {mass:g} kg between the joints "
                f"of a link of {length:g} m can have: does it belong to a longer link, or is it about a joint?"
            )
    return found


def mistaken_units(values: Mapping[str, Value]) -> list[str]:
    """Sentences on the first angle that looks like degrees and the first length that looks like millimetres."""
    found = []
    for name in ANGLES:
        if (turns := abs(values[name]) / math.tau) > MOST_TURNS:
            found.append(f"{name} is {values[name]:g} rad, which is {turns:.0f} turns: is it in degrees?")
            break
    for name in LENGTHS:
        if values[name] > LONGEST:
            found.append(f"{name} is {values[name]:g} m: is it in millimetres?")
            break
    return found
