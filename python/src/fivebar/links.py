"""Checks whether the mass of each link can lie between its joints.

If it does, the centre of mass c lies between the joints at 0 and l too. The inertia of the mass m about c is largest if all
mass is at the joints: m c (l - c).
"""

from collections.abc import Mapping

from fivebar.variables import Value


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
