"""Links that no machine has whose mass lies between its joints: their centre of mass is there too, and their inertia is bounded.

Of a mass m between 0 and l, with its centre at c, the inertia about the centre is largest where all lies at the ends: m c (l - c).
"""

from collections.abc import Mapping

from fivebar.variables import Value


def doubts(values: Mapping[str, Value]) -> list[str]:
    """Sentences on links, of a machine given by all its start values, whose mass cannot lie between their joints."""
    found = []
    for link in (f"link[{i}]" for i in (1, 2, 3, 4)):
        length, mass, com, inertia = (float(values[f"{link}.{name}"]) for name in ("length", "mass", "com", "inertia"))
        if not 0.0 <= com <= length:
            found.append(
                f"{link}.com is {com:g} m, beyond the joints of a link of {length:g} m: are both of the same link?"
            )
        # Rods with their mass at both ends are as they are by rounding only.
        elif inertia > (most := mass * com * (length - com)) * (1 + 1e-9):
            found.append(
                f"{link}.inertia is {inertia:g} kg.m2 about the centre of mass, more than the {most:.3g} kg.m2 that {mass:g} kg between the joints "
                f"of a link of {length:g} m can have: is it of a longer link, or about a joint?"
            )
    return found
