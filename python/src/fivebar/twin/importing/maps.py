"""The map of a recording: the column of each variable, and the conversion of its numbers to rad, rad/s, N.m and m.

    {
      "time": {"column": "t", "unit": "ms"},
      "measured.theta[1]": {"column": "enc_left", "unit": "counts", "steps": 8192, "sign": -1, "offset": "90 deg"},
      "measured.theta[2]": {"column": "enc_right", "unit": "deg"}
    }

The value of a variable is sign x scale x number in its unit + offset. Without a map, columns are named as the variables.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from fivebar import scene_file, table
from fivebar.errors import FiveBarError
from fivebar.twin.messages import MEAS_FIELDS, MEASURED
from fivebar.twin.recording import TIME, TRUE
from fivebar.variables import shown, similar

PASSIVE: Final = ("passive.theta[1]", "passive.theta[2]")
"""Angles of the distal links. They are not fields of `meas`, but reveal the assembly of the machine and the order of the encoders."""

VARIABLES: Final = (*MEAS_FIELDS, *PASSIVE)

ANGLES: Final = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "turns": 2 * math.pi}
LENGTHS: Final = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
COUNTS: Final = "counts"
UNITS: Final[dict[str, dict[str, float]]] = {
    TIME: {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "theta": ANGLES,
    "omega": {f"{name}/s": factor for name, factor in ANGLES.items()} | {"rpm": 2 * math.pi / 60},
    "tau": {"N.m": 1.0, "mN.m": 1e-3},
    "tip.x": LENGTHS,
    "tip.y": LENGTHS,
}
"""Units and their factors by the end of a variable's name; the first unit is the variable's own."""

KEYS: Final = ("column", "unit", "steps", "sign", "scale", "offset", "relative")


@dataclass(frozen=True)
class Entry:
    """Conversion of a column to a variable."""

    column: str
    unit: str = ""
    """"" is the unit in the table's head, or else the variable's unit."""

    steps: float = 0.0
    """Encoder counts per turn, for the unit `counts`."""

    sign: int = 1
    scale: float = 1.0
    offset: float = 0.0
    """Offset in the unit of the variable."""

    relative: bool = False
    """Whether a distal link's angle is relative to its proximal link."""

    def content(self) -> dict[str, Any]:
        """JSON content of the entry: the values that differ from the defaults."""
        found: dict[str, Any] = {"column": self.column}
        for key in KEYS[1:]:
            if (value := getattr(self, key)) != Entry.__dataclass_fields__[key].default:
                found[key] = round(value, 6) if key == "offset" else value
        return found

    def factor(self, name: str, head: str) -> float:
        """Factor for the numbers of the column; `head` is the unit in the table's head. Raises FiveBarError."""
        known = units_of(name)
        unit, in_head = self.unit, table.spelled(head)
        if self.scale != 1 and in_head not in known:
            # A scale converts from any unit, such as N.m per A.
            in_head = ""
        if in_head and unit and in_head != unit:
            raise FiveBarError(
                f"'{name}.unit' is '{unit}', but the head of the table says that {self.column} is in {head:.20}"
            )
        unit = unit or in_head or next(iter(known))
        if unit == COUNTS and self.steps and "theta" in name:
            return self.sign * self.scale * 2 * math.pi / self.steps
        if unit not in known:
            raise FiveBarError(f"{self.column} is in {head:.20}; {', '.join(known)} is allowed for {name}")
        return self.sign * self.scale * known[unit]


@dataclass(frozen=True)
class Map:
    """A map: the entry of the clock, and the entries of variables by name."""

    time: Entry = Entry(TIME)
    entries: Mapping[str, Entry] = field(default_factory=dict)
    """Empty: columns are named as the variables."""

    def content(self) -> dict[str, Any]:
        """JSON content of the map."""
        time = {} if self.time == Entry(TIME) else {TIME: self.time}
        return {name: entry.content() for name, entry in (time | dict(self.entries)).items()}

    def text(self) -> str:
        """The JSON text, with one line per variable."""
        lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(entry)}" for name, entry in self.content().items())
        return "{\n" + lines + "\n}"

    def in_unit(self, name: str, unit: str) -> "Map":
        """A copy in which the column of a variable, or of the time, is in another unit."""
        if name == TIME:
            return replace(self, time=replace(self.time, unit=unit))
        return self.exchanged({name: replace(self.entries[name], unit=unit)})

    def exchanged(self, entries: Mapping[str, Entry]) -> "Map":
        """A copy with other entries for some variables."""
        return replace(self, entries={**self.entries, **entries})


def read(file: Path) -> Map:
    """Reads a map from a file. Raises FiveBarError with one sentence that names the file."""
    try:
        return parse(scene_file.parse(scene_file.text(file)))
    except FiveBarError as error:
        raise FiveBarError(f"{file}: {error}") from None


def parse(content: Any) -> Map:
    """The map from JSON content. Raises FiveBarError with one sentence that names key and value."""
    if not isinstance(content, dict):
        raise FiveBarError("a map must be an object of variables and their columns")
    known = (scene_file.DESCRIPTION, TIME, *VARIABLES)
    for name in content:
        if name not in known:
            end = f"; did you mean '{TRUE[name]}'?" if name in TRUE else similar(name, known)
            raise FiveBarError(f"'{name}' is not a variable of a recording{end}")
    entries = {name: _entry(name, given) for name, given in content.items() if name != scene_file.DESCRIPTION}
    time = entries.pop(TIME, Entry(TIME))
    if not any(name in entries for name in MEASURED):
        raise FiveBarError(f"it has neither {MEASURED[0]} nor {MEASURED[1]}")
    for i, name in enumerate(PASSIVE):
        if name in entries and entries[name].relative and MEASURED[i] not in entries:
            raise FiveBarError(f"'{name}.relative' needs {MEASURED[i]}, to which it is relative")
    for name, entry in entries.items():
        if entry.column == time.column:
            raise FiveBarError(f"'{name}.column' is {entry.column:.60}, the column of the time: it must be another one")
    return Map(time, entries)


def units_of(name: str) -> dict[str, float]:
    """Allowed units for the column of a variable, with their factors."""
    return next(units for last, units in UNITS.items() if name.partition("[")[0].endswith(last))


def _entry(name: str, given: Any) -> Entry:
    if not isinstance(given, dict):
        raise FiveBarError(f'\'{name}\' must be an object such as {{"column": "q1"}}, not {shown(given)}')
    keys = ("column", "unit") if name == TIME else KEYS if name in PASSIVE else KEYS[:-1]
    for key in given:
        if key not in keys:
            raise FiveBarError(f"'{name}' has no key '{key}'{similar(key, keys)}")
    column = given.get("column")
    # In tables without a head, columns are named by number.
    if isinstance(column, int) and not isinstance(column, bool) and column > 0:
        column = str(column)
    if not isinstance(column, str) or not column.strip():
        raise FiveBarError(
            f"'{name}.column' must be the name of a column, or its number from 1 on, not {shown(column)}"
        )
    allowed = [*units_of(name), *([COUNTS] if "theta" in name else [])]
    unit = given.get("unit", "")
    if "unit" in given and unit not in allowed:
        raise FiveBarError(f"'{name}.unit' must be one of {', '.join(allowed)}, not {shown(unit)}")
    steps = _number(f"{name}.steps", given.get("steps", 0.0))
    if (unit == COUNTS) != ("steps" in given) or steps < 0 or (unit == COUNTS and steps == 0):
        raise FiveBarError(
            f"'{name}.steps' must be the steps of a turn, more than 0, for the unit {COUNTS} and for no other one, not {shown(given.get('steps'))} with the unit "
            f"{shown(unit)}"
        )
    sign = given.get("sign", 1)
    if isinstance(sign, bool) or sign not in (1, -1):
        raise FiveBarError(f"'{name}.sign' must be 1 or -1, not {shown(sign)}")
    scale = _number(f"{name}.scale", given.get("scale", 1.0))
    if scale == 0:
        raise FiveBarError(f"'{name}.scale' must be a number other than 0, not {shown(given['scale'])}")
    relative = given.get("relative", False)
    if not isinstance(relative, bool):
        raise FiveBarError(f"'{name}.relative' must be true or false, not {shown(relative)}")
    return Entry(column.strip(), unit, steps, int(sign), scale, _offset(name, given.get("offset", 0.0)), relative)


def _offset(name: str, given: Any) -> float:
    """Parses a number in the variable's unit, or a text with number and unit such as "147 deg"."""
    if not isinstance(given, str):
        return _number(f"{name}.offset", given)
    units = units_of(name)
    number, _, unit = given.strip().partition(" ")
    try:
        value = float(number) * units[unit.strip()]
    except (ValueError, KeyError):
        value = math.nan
    if not math.isfinite(value):
        raise FiveBarError(
            f"'{name}.offset' must be a number in {next(iter(units))}, or a text such as \"90 {list(units)[:3][-1]}\" with one of {', '.join(units)}, not {shown(given)}"
        )
    return value


def _number(key: str, given: Any) -> float:
    if not isinstance(given, (int, float)) or isinstance(given, bool):
        raise FiveBarError(f"'{key}' must be a number, not {shown(given)}")
    return float(given)
