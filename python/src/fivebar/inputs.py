"""Samples time-varying inputs of Python callers at the communication points of a run."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fivebar import arguments
from fivebar.errors import FiveBarError, warn
from fivebar.variables import Variables, is_number, plain, shown

Floats = NDArray[np.float64]

Inputs = Mapping[str, Any] | Callable[[float], Mapping[str, float]] | Any
"""A mapping from name to a number, to values at the communication points, or to a pair (times, values) for linear interpolation.

With a key `time`, s, all other values belong to these times; a number is constant. A pandas frame with a column or an index `time` and a function of
time that returns values by name are allowed too. An array without its index has a number for each element, or rows of them.
"""

TIME = "time"

MUCH_LATER = 100.0
"""Times of a table beyond this multiple of the stop time are taken for milliseconds, which are 1000 times as many; few runs are so short a
part of their table.
"""


def sampled(given: Inputs | None, points: Floats, variables: Variables) -> dict[str, Floats]:
    """Values of the inputs by name at the communication points, s; each is constant over the following step."""
    if given is None:
        return {}
    if callable(given):
        courses = _of_function(given, points, variables)
    else:
        courses = _of_table(_flat(_columns(given), variables), points)
    for name, values in courses.items():
        variable = variables.get(name)
        if variable is None or variable.type != "Real" or variable.variability != "tunable":
            variable = variables.input(name)
        for row in np.flatnonzero(~np.isfinite(values)):
            raise FiveBarError(f"the input '{name}' must be finite, but is {values[row]} at {points[row]:g} s")
        for extreme in (np.min(values), np.max(values)):
            variable.value(float(extreme))
    return courses


def _columns(given: Any) -> Mapping[str, Any]:
    """The mapping itself, or the columns of a frame by name."""
    if isinstance(given, Mapping):
        return arguments.values("inputs", given)
    if not (hasattr(given, "columns") and hasattr(given, "index")):
        raise FiveBarError(f"inputs are a dict, a frame of pandas or a function of time, not {shown(given)}")
    columns = {str(name): given[name] for name in given.columns}
    if TIME not in columns:
        if given.index.name != TIME:
            raise FiveBarError(f"a frame of inputs needs a column or an index '{TIME}', s")
        columns[TIME] = given.index
    return columns


def _flat(given: Mapping[str, Any], variables: Variables) -> dict[str, Any]:
    """The inputs with arrays split into their elements."""
    found = {}
    for name, value in given.items():
        if (elements := variables.arrays.get(name)) is None:
            found[name] = value
            continue
        is_pair = isinstance(value, tuple) and len(value) == 2 and not is_number(plain(value[0]))
        rows = _numbers(name, value[1] if is_pair else value, 2)
        if rows.ndim < 1 + is_pair or rows.shape[-1] != len(elements):
            raise FiveBarError(
                f"the input '{name}' has {len(elements)} elements, {elements[0].name} to {elements[-1].name}: a number for each, a row of "
                f"numbers for each communication point, or a pair (times, rows) is needed, not {shown(value)}"
            )
        found |= {v.name: (value[0], column) if is_pair else column for v, column in zip(elements, rows.T, strict=True)}
    return found


def _of_function(
    function: Callable[[float], Mapping[str, Any]], points: Floats, variables: Variables
) -> dict[str, Floats]:
    rows = [function(time) for time in points.tolist()]
    for time, row in zip(points.tolist(), rows):
        if not isinstance(row, Mapping) or row.keys() != rows[0].keys():
            raise FiveBarError(
                f"the function of inputs must return a dict with the same names at all times, but returned {shown(row)} at {time:g} s"
            )
    arguments.values("inputs", rows[0])
    flat = [variables.flat(row) for row in rows]
    return {name: _numbers(name, [row[name] for row in flat]) for name in flat[0]}


def _of_table(given: Mapping[str, Any], points: Floats) -> dict[str, Floats]:
    shared = given.get(TIME)
    courses: dict[str, Floats] = {}
    ends: dict[str, float] = {}
    for name, value in given.items():
        if name == TIME:
            continue
        if shared is not None and not is_number(plain(value)):
            value = (shared, value)
        if isinstance(value, tuple) and len(value) == 2:
            courses[name], ends[name] = _joined(name, *value, points)
            continue
        values = _numbers(name, value)
        if values.shape not in ((), points.shape):
            raise FiveBarError(
                f"the input '{name}' has {values.size} values, but the run has {len(points)} communication points: one value for each, or "
                "a pair (times, values), is needed"
            )
        courses[name] = np.full(len(points), values) if values.shape == () else values
    for name, end in ends.items():
        if end > MUCH_LATER * points[-1]:
            warn(
                f"the times of input '{name}' end at {end:g} s, but the run at {points[-1]:g} s: are they in milliseconds?"
            )
            break
    return courses


def _joined(name: str, times: Any, values: Any, points: Floats) -> tuple[Floats, float]:
    """Linear interpolation of values at times, constant before the first and after the last time; and the last time, s."""
    at, course = _numbers(f"time of {name}", times), _numbers(name, values)
    if at.ndim != 1 or course.ndim != 1:
        raise FiveBarError(
            f"the input '{name}' must be a number, values at the communication points, or a pair of lists (times, values), not {shown((times, values))}"
        )
    if at.shape != course.shape or not len(at):
        raise FiveBarError(
            f"the input '{name}' has {course.size} values but {at.size} values of time: the counts must be equal"
        )
    if not np.all(np.isfinite(at)):
        raise FiveBarError(f"the times of input '{name}' must be finite")
    for row in np.flatnonzero(~(np.diff(at) > 0)):
        raise FiveBarError(f"the times of input '{name}' must increase, but {at[row + 1]} s follows {at[row]} s")
    for row in np.flatnonzero(~np.isfinite(course)):
        raise FiveBarError(f"the input '{name}' must be finite, but is {course[row]} at {at[row]:g} s")
    return np.interp(points, at, course), float(at[-1])


def _numbers(name: str, given: Any, dimensions: int = 1) -> Floats:
    """The numbers as an array of at most so many dimensions."""
    try:
        values = np.asarray(given)
    except ValueError:
        # Rows of different lengths.
        values = np.asarray(None)
    if values.dtype.kind not in "iuf" or values.ndim > dimensions:
        raise FiveBarError(f"the input '{name}' must have one number for each time, not {shown(given)}")
    return values.astype(np.float64)
