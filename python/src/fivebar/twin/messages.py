"""The messages: points in JSON in the format of the Incubator, one per sample, with fields named as the unit's variables.

    {"measurement": "meas", "time": 1795331400000000000, "seq": 17, "tags": {"unit": "bench"}, "fields": {"measured.theta[1]": 1.57, …}}

`time` is in ns since 1970 on the machine's clock, `seq` counts samples. `messages.schema.json` defines the content of each kind. It is a
JSON Schema that all readers use, also the dashboard's page. Messages from `decode` are completely checked: kind, types, sizes, finite
numbers, names, ranges. Received data is never executed or unpickled.
"""

import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

import fastjsonschema

from fivebar.twin import units
from fivebar.twin.errors import Refused

KINDS: Final = (
    "meas",
    "est",
    "forecast",
    "alarm",
    "param",
    "cmd",
    "state",
    "ahead",
    "learned",
    "whatif",
    "gap",
    "setup",
)
"""Kinds of messages; the last part of a topic. `state` contains the twin's state for replays. `ahead` contains a state from which a
forecast starts, and is not recorded. `gap` (missing messages) and `setup` (of the run) are only in records."""

LARGEST: Final = {"state": 64_000, "ahead": 64_000, "whatif": 64_000, "forecast": 64_000, "setup": 2_000_000}
"""Maximum size of a message by kind, bytes; other kinds have `LARGEST_USUAL`."""

LARGEST_USUAL: Final = 16_000

UNIT_NAME: Final = re.compile(r"[A-Za-z0-9_-]{1,64}")

SCHEMA_FILE: Final = Path(__file__).with_name("messages.schema.json")
SCHEMA: Final[dict[str, Any]] = json.loads(SCHEMA_FILE.read_text(encoding="utf-8"))

SERVOS: Final = ("servo.theta[1]", "servo.theta[2]")

TORQUES: Final = ("tau[1]", "tau[2]")
INPUTS: Final = (*SERVOS, *(f"{name}[{i}]" for name in ("servo.omega", "tau") for i in (1, 2)))
"""Drive commands: fields of `meas` that the twin passes to its unit."""

MEASURED: Final = ("measured.theta[1]", "measured.theta[2]")

TRACKED: Final = ("tip.x", "tip.y")
"""Tip position from an external tracker: recorded and compared, never used by the twin."""

MEAS_FIELDS: Final = (*MEASURED, *INPUTS, *TRACKED)
"""All fields of `meas`: rad, rad/s, N.m, m."""


@dataclass(frozen=True)
class Message:
    """A checked message. `extra` contains values that are not scalars of the unit: path of a forecast, cause of an alarm."""

    kind: str
    unit: str
    time: int
    seq: int
    fields: dict[str, float]
    extra: dict[str, Any] = field(default_factory=dict)


def topic(unit: str, kind: str) -> str:
    """The MQTT topic for a kind of message."""
    return f"fivebar/{unit}/{kind}"


def encode(message: Message) -> bytes:
    """Encodes a message for sending: equal messages give equal bytes, and all numbers are exact to the bit."""
    content = {
        "measurement": message.kind,
        "time": message.time,
        "seq": message.seq,
        "tags": {"unit": message.unit},
        "fields": message.fields,
    }
    return json.dumps(content | message.extra, allow_nan=False, separators=(",", ":")).encode()


def decode(from_topic: str, payload: bytes) -> Message:
    """Decodes and checks a message. Raises `Refused` with one sentence."""
    prefix, _, rest = from_topic.partition("/")
    unit, _, kind = rest.partition("/")
    _require(
        prefix == "fivebar" and kind in KINDS and UNIT_NAME.fullmatch(unit) is not None,
        f"topic {from_topic[:100]!r} is not fivebar/UNIT/KIND",
    )
    most = LARGEST.get(kind, LARGEST_USUAL)
    _require(len(payload) <= most, f"{kind} of {len(payload)} bytes; at most {most} are allowed")
    content = _parse(kind, payload)
    _check(kind, content)
    _require(content["tags"]["unit"] == unit, f"tags are {_show(content['tags'])}; the unit of this topic is {unit!r}")
    for name in ("time", "seq"):
        # JSON Schema accepts 1.0 as an integer, but the code needs an int.
        _require(isinstance(content[name], int), _no_integer(name, content[name]))
    fields = {name: float(value) for name, value in content["fields"].items()}
    extra = {
        name: value for name, value in content.items() if name not in ("measurement", "time", "seq", "tags", "fields")
    }
    return Message(kind, unit, content["time"], content["seq"], fields, extra)


def _parse(kind: str, payload: bytes) -> dict[str, Any]:
    try:
        content = json.loads(payload.decode("utf-8"), parse_constant=_no_constant, object_pairs_hook=_no_doubles)
    except Refused:
        raise
    except (ValueError, RecursionError) as error:
        raise Refused(f"{kind} is not JSON: {str(error)[:100]}") from None
    if not isinstance(content, dict):
        raise Refused(f"{kind} is {_show(content)}, not an object")
    return content


def _no_constant(name: str) -> float:
    raise Refused(f"{name} is not a JSON number")


def _no_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    _require(len(content) == len(pairs), "a name stands twice in an object")
    return content


@cache
def _validator(kind: str) -> Callable[[Any], Any]:
    """The schema of a kind as a function. fastjsonschema compiles it to Python, which takes some 10 µs instead of 1 ms per message."""
    schema = {name: SCHEMA[name] for name in ("$schema", "definitions")} | {
        "allOf": [{"$ref": f"#/definitions/{kind}"}]
    }
    return fastjsonschema.compile(schema)


def _check(kind: str, content: dict[str, Any]) -> None:
    try:
        _validator(kind)(content)
    except fastjsonschema.JsonSchemaValueException as error:
        raise Refused(f"{kind}: {_sentence(error)}") from None


def _sentence(error: fastjsonschema.JsonSchemaValueException) -> str:
    """Sentence about an error: the field, its value and the allowed values."""
    name = (error.name or "").removeprefix("data").removeprefix(".").removeprefix("fields.")[:80] or "the message"
    name = "".join(each if each.isprintable() else "?" for each in name)
    value, rule, allowed = error.value, error.rule, error.rule_definition
    if rule == "required":
        return f"{name} has no {next(each for each in allowed if each not in value)}"
    if rule == "additionalProperties" and allowed is False:
        known = error.definition["properties"]
        return f"{name} has {_show(next(each for each in value if each not in known))}, which it may not have"
    if rule == "anyOf" and all("required" in each for each in allowed):
        return f"{name} has neither {' nor '.join(each['required'][0] for each in allowed)}"
    if type(value) in (int, float) and (not math.isfinite(value) if isinstance(value, float) else abs(value) > 10**308):
        return f"{name} is {_show(value)}, not a finite number"
    if rule == "type" and allowed == "integer":
        return _no_integer(name, value)
    if rule == "type":
        kinds = allowed if isinstance(allowed, list) else [allowed]
        return f"{name} is {_show(value)}, not {' or '.join(f'an {each}' if each[0] in 'aio' else f'a {each}' for each in kinds)}"
    if rule == "const":
        return f"{name} is {_show(value)}, not {allowed}"
    if rule == "enum":
        return f"{name} is {_show(value)}, not one of {', '.join(map(str, allowed))}"
    if rule in ("minimum", "maximum"):
        return f"{name} is {_show(value)}; {error.definition.get('minimum', '-inf')} to {error.definition.get('maximum', 'inf')} is allowed"
    return f"{name} is {_show(value)}; {rule} {_show(allowed)} is allowed"


def _no_integer(name: str, value: Any) -> str:
    """Sentence about a value that is not an integer; a time with a fraction is usually in s."""
    unit = units.of_time(value) if name == "time" and isinstance(value, float) else None
    if unit is not None:
        return units.asks_by_time("the message", value, unit)
    return f"{name} is {_show(value)}, not an integer"


def _show(value: Any) -> str:
    """Text of a value, at most one line."""
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > 10**40:
        return "an integer of very many digits"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _require(holds: bool, sentence: str) -> None:
    if not holds:
        raise Refused(sentence)
