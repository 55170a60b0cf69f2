"""Checks of arguments. Each error is one sentence with the argument, its value and what is allowed."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from fivebar.errors import FiveBarError
from fivebar.variables import is_number, plain, shown


def number(what: str, given: Any, unit: str = "s") -> float:
    """A number, also of NumPy."""
    found = plain(given)
    if not is_number(found):
        raise FiveBarError(f"'{what}' must be a number in {unit}, not {shown(given)}")
    return float(found)


def count(what: str, given: Any) -> int:
    """A whole number of at least 1, also of NumPy."""
    if not isinstance(given, (int, np.integer)) or isinstance(given, bool) or given < 1:
        raise FiveBarError(f"'{what}' must be a whole number of at least 1, not {shown(given)}")
    return int(given)


def names(what: str, given: Any) -> tuple[str, ...]:
    """One name or several."""
    found = tuple(given) if isinstance(given, Iterable) and not isinstance(given, (str, bytes)) else (given,)
    if not all(isinstance(name, str) for name in found):
        raise FiveBarError(f"'{what}' must be a name or a list of names, not {shown(given)}")
    return found


def values(what: str, given: Any) -> Mapping[str, Any]:
    """A dict with names as keys."""
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        raise FiveBarError(f"'{what}' must be a dict from names to values, not {shown(given)}")
    return given
