"""Numbers for sentences."""

import numpy as np


def plain(value: float, digits: int = 3) -> str:
    """A number with so many significant digits and without an exponent: 1230, not 1.23e+03."""
    return np.format_float_positional(float(f"{value:.{digits}g}"), trim="-")
