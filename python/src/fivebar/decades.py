"""Labels of logarithmic axes in plain text, such as 10⁻⁶. Matplotlib's own labels are formulas, and a formula takes 30 times as long to set."""

import re

from matplotlib.ticker import LogFormatterSciNotation

FORMULA = re.compile(r"\$\\mathdefault\{(?:(.+)\\times)?10\^\{([-0-9]+)}}\$")
"""A label of matplotlib: factor, if it is not 1, and exponent of a power of ten."""

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Decades(LogFormatterSciNotation):
    """Sets the same labels at the same ticks as matplotlib."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return FORMULA.sub(_plain, super().__call__(x, pos))


def _plain(label: re.Match[str]) -> str:
    factor, exponent = label.groups()
    return f"{f'{factor} × ' if factor else ''}10{exponent.translate(RAISED)}"
