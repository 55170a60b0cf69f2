"""A scene's file: JSON without repeated keys; its keys, runs and experiment are checked against the unit's variables."""

import json
import math
import re
import unicodedata
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fivebar import encoding, signals, tip_scenes
from fivebar.errors import FiveBarError
from fivebar.signals import Signal
from fivebar.variables import Value, Values, Variable, Variables, is_number, plain, shown, similar

LARGEST = 4_000_000
"""Largest size of a file, bytes."""

MOST_BRACKETS = 8
"""Deepest nesting of brackets; a scene needs five."""

DESCRIPTION, EXPERIMENT, SIGNALS, OVERLAY = ("description", "experiment", "signals", "overlay")

SCHEMA = "$schema"
"""Key with which editors find the schema of scenes."""

OFFSETS = ("encoder.offset[1]", "encoder.offset[2]")
"""Keys of the encoder offsets, rad: encoder reading minus true angle. All other angles of a scene are true angles."""

RESERVED = (SCHEMA, DESCRIPTION, EXPERIMENT, SIGNALS, OVERLAY, *OFFSETS, *tip_scenes.KEYS)
"""Keys of a scene that are not settable variables."""

LABEL = "label"
"""Key of an overlay that is not a variable."""

SECONDS = ("stopTime", "stepSize")


class Content:
    """Checked content of a scene's file."""

    def __init__(self, content: Any, variables: Variables):
        if not isinstance(content, dict):
            raise FiveBarError("a scene must be an object of variable names and values")
        self.values = _values(
            {name: value for name, value in content.items() if name not in RESERVED}, variables, RESERVED
        )
        if SCHEMA in content:
            _text(SCHEMA, content)
        self.offsets = {name: _angle(name, content[name]) for name in OFFSETS if name in content}
        """Encoder offsets, rad, by key."""
        stop_time, self.step_size = _experiment(content, variables)
        self.description = _text(DESCRIPTION, content)
        self.overlays = list(_overlays(content, self.values, variables))
        """Labels and values of further runs."""
        self.signals: list[Signal] = signals.read(content.get(SIGNALS), variables)
        self.assumed: dict[str, str] = {}
        """Note on the stop time if the file has none."""
        if stop_time is None:
            stop_time, self.assumed["stop time"] = _end(self.signals, variables)
        self.stop_time = stop_time
        self.tip = tip_scenes.read(content, self.values, self.signals, variables)
        check_labels([method(self.values, variables), *(label for label, _ in self.overlays)])
        check_signals(
            [self.values, *(values for _, values in self.overlays)],
            [*(signal.variable.name for signal in self.signals), *(self.tip.follows if self.tip else ())],
        )


def text(file: Path) -> str:
    """Text of a scene's file."""
    return encoding.read(file, LARGEST)


def parse(text: str) -> Any:
    """Parses JSON; refuses numbers that are not finite, and repeated keys."""
    try:
        content = json.loads(
            text, object_pairs_hook=_unique, parse_int=_integer, parse_float=_finite, parse_constant=_none
        )
        _check_brackets(content, MOST_BRACKETS)
        json.dumps(content, ensure_ascii=False).encode()
    except RecursionError:
        raise FiveBarError(f"it is not valid JSON: more than {MOST_BRACKETS} brackets are nested") from None
    except UnicodeEncodeError:
        raise FiveBarError("it is not valid JSON: a text contains half of a character") from None
    except FiveBarError:
        raise
    except ValueError as error:
        raise FiveBarError(f"it is not valid JSON: {error}") from None
    return content


def method(values: Mapping[str, Value], variables: Variables) -> str:
    """Name of the method of a run."""
    variable = variables["solver.method"]
    number = values.get(variable.name, variable.start)
    assert isinstance(number, int)
    return variable.item(number)


def check_labels(labels: list[str]) -> None:
    """Refuses equal labels."""
    for i, label in enumerate(labels):
        if label in labels[:i]:
            raise FiveBarError(f"two runs have the label '{label}', but labels must differ")


def check_signals(runs: list[Values], signalled: Iterable[str]) -> None:
    """Refuses a signal and a value of the same variable."""
    for name in [name for values in (*runs[1:], runs[0]) for name in values]:
        if name in signalled:
            raise FiveBarError(f"'{name}' has a signal and a value, but only one of them is allowed")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"'{key}' is given twice")
        found[key] = value
    return found


def _integer(text: str) -> int | float:
    # -0 is a Real; whole numbers with more than 64 bits are not Integers, and Python limits their digits.
    if text == "-0" or len(text) > 19:
        return _finite(text)
    return int(text)


def _finite(text: str) -> float:
    if math.isinf(value := float(text)):
        raise ValueError(f"number {text[:40]} is out of range")
    return value


def _none(text: str) -> float:
    raise ValueError(f"{text} is not a JSON number")


def _check_brackets(content: Any, left: int) -> None:
    if isinstance(content, (dict, list)):
        if left == 0:
            raise ValueError(f"more than {MOST_BRACKETS} brackets are nested")
        for value in content.values() if isinstance(content, dict) else content:
            _check_brackets(value, left - 1)


def _values(given: Mapping[str, Any], variables: Variables, reserved: Iterable[str]) -> Values:
    return {name: settable(name, variables, reserved).value(value) for name, value in given.items()}


def settable(name: str, variables: Variables, others: Iterable[str] = ()) -> Variable:
    """The parameter or input of this name; `others` are further suggestions for a misspelt name."""
    if name.replace("_", "").lower() in (key.lower() for key in SECONDS):
        raise FiveBarError(
            f"{name!r} is not a variable: in Python use the arguments stop_time and step_size, s; in a scene's file stopTime and stepSize "
            f"belong under '{EXPERIMENT}'"
        )
    return variables.settable(name, others)


def _angle(key: str, given: Any) -> float:
    if not isinstance(given, (int, float)) or isinstance(given, bool) or not abs(given) <= math.pi:
        raise FiveBarError(f"'{key}' must be an angle of -pi to pi in rad, not {shown(given)}")
    return float(given)


def _text(key: str, content: Mapping[str, Any]) -> str:
    if key not in content:
        raise FiveBarError(f"it has no text '{key}'")
    given = content[key]
    if isinstance(given, str) and any(map(_is_no_text, given)):
        raise FiveBarError(f"'{key}' must be a text without control characters, not {shown(given)}")
    if not isinstance(given, str) or not given.strip():
        raise FiveBarError(f"'{key}' must be a text, not {shown(given)}")
    return given


def described(given: Any) -> str:
    """A description."""
    return _text(DESCRIPTION, {DESCRIPTION: given})


def name(given: Any) -> str:
    """A name of a scene, which names files."""
    found = _text("name", {"name": given})
    if not found.strip(". ") or re.search(r"[/\\:]", found):
        raise FiveBarError(f"'name' must be a name of a file without its folder, not {shown(given)}")
    return found


def _is_no_text(c: str) -> bool:
    """Whether the character cannot be in a line of XML, a table or a page (XML 1.0, section 2.2)."""
    return unicodedata.category(c) == "Cc" or c in "\u2028\u2029\ufffe\uffff"


def _experiment(content: Mapping[str, Any], variables: Variables) -> tuple[float | None, float]:
    """Stop time, s, None if not given; and communication step, s, the unit's if not given."""
    given = content.get(EXPERIMENT, {})
    if not isinstance(given, dict):
        raise FiveBarError(
            f'\'{EXPERIMENT}\' must be an object such as {{"stopTime": 2, "stepSize": 0.001}}, not {shown(given)}'
        )
    for key in given:
        if key not in SECONDS:
            raise FiveBarError(f"'{EXPERIMENT}' has no key '{key}'{similar(key, SECONDS)}")
    found: dict[str, float] = {}
    for key in SECONDS:
        if key not in given:
            continue
        found[key] = seconds(f"{EXPERIMENT}.{key}", given[key])
    return found.get("stopTime"), found.get("stepSize", variables.step_size)


def seconds(key: str, given: Any) -> float:
    """A stop time or a step, s."""
    given = plain(given)
    if not is_number(given) or not given > 0:
        raise FiveBarError(f"'{key}' must be a positive number of seconds, not {shown(given)}")
    return float(given)


def _end(own: list[Signal], variables: Variables) -> tuple[float, str]:
    """Stop time, s, of a scene without one: the end of its signals, or else the unit's stop time; and a note."""
    last = max((signal.end for signal in own), default=0.0)
    if last > 0:
        return last, f"{last:g} s, the last knot of its signals: it has no 'experiment.stopTime'"
    return (
        variables.stop_time,
        f"{variables.stop_time:g} s, the unit's own: it has no 'experiment.stopTime' and no signals",
    )


def _overlays(content: Mapping[str, Any], own: Values, variables: Variables) -> Iterable[tuple[str, Values]]:
    given = content.get(OVERLAY, [])
    if not isinstance(given, list):
        raise FiveBarError(f"'{OVERLAY}' must be a list of runs, not {shown(given)}")
    for number, item in enumerate(given, 1):
        try:
            yield _overlay(item, own, variables)
        except FiveBarError as error:
            raise FiveBarError(f"overlay {number}: {error}") from None


def _overlay(given: Any, own: Values, variables: Variables) -> tuple[str, Values]:
    if not isinstance(given, dict):
        raise FiveBarError(
            f"it must be an object with a '{LABEL}' and the values that replace the scene's, not {shown(given)}"
        )
    label = _text(LABEL, given)
    changes = _values({name: value for name, value in given.items() if name != LABEL}, variables, (LABEL,))
    return label, {name: value for name, value in own.items() if name not in changes} | changes
