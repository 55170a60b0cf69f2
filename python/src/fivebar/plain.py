"""Numbers for sentences."""

from typing import Final

import numpy as np

DECIMALS: Final = 6
"""Maximum number of decimals."""


def plain(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, at most 6 decimals and without an exponent: 1230, not 1.23e+03.

    Values below 1e-6 in size become 0: they are round-off in the units used.
    """
    if abs(value) < 10**-DECIMALS:
        return "0"
    return np.format_float_positional(round(float(f"{value:.{digits}g}"), DECIMALS), trim="-")
