"""The messages: points in JSON as the Incubator has them, one a sample, fields under the names of the unit's variables.

    {"measurement": "meas", "time": 1795331400000000000, "seq": 17, "tags": {"unit": "bench"}, "fields": {"measured.theta[1]": 1.57, …}}

`time` is in ns since 1970 on the machine's clock, `seq` counts samples. What `decode` returns has been checked completely: kind,
types, sizes, finite numbers, names, ranges. Nothing that is received is ever executed or unpickled.
"""

import json
import math
import re
from dataclasses import dataclass, field
from typing import Any, Final

from fivebar_twin.errors import Refused

KINDS: Final = ("meas", "est", "forecast", "alarm", "param", "cmd", "state", "ahead", "whatif", "gap", "setup")
"""The last part of a topic. `state` has the twin's stored state, for replays; `ahead` has one that a forecast is to start from, and is
not recorded. The last two are only in records: what is missing in them, and of which run they are."""

LARGEST: Final = {"state": 64_000, "ahead": 64_000, "whatif": 64_000, "forecast": 64_000, "setup": 2_000_000}
"""Bytes of a message, where they are more than `LARGEST_USUAL`."""

LARGEST_USUAL: Final = 16_000

LATEST: Final = 2**63 - 1
"""The last ns that a time can have: the year 2262."""

MOST_SAMPLES: Final = 2**53 - 1
"""The largest `seq`: JavaScript counts as far."""

UNIT_NAME: Final = re.compile(r"[A-Za-z0-9_-]{1,64}")
COMMANDS: Final = ("restart", "acknowledge")
"""What `cmd` may ask for: the twin to start anew from the next sample; the watch to take note and cool down."""

INPUTS: Final = tuple(f"{name}[{i}]" for name in ("servo.theta", "servo.omega", "tau") for i in (1, 2))
"""What drives are told: fields of `meas` that the twin hands to its unit."""

MEASURED: Final = ("measured.theta[1]", "measured.theta[2]")

TRACKED: Final = ("tip.x", "tip.y")
"""What a tracker outside the machine may see of the tip: recorded and compared with, never used by the twin."""

MEAS_RANGES: Final = (
    dict.fromkeys(MEASURED + ("servo.theta[1]", "servo.theta[2]"), 1e4)
    | {f"servo.omega[{i}]": 1e4 for i in (1, 2)}
    | {f"tau[{i}]": 1e4 for i in (1, 2)}
    | dict.fromkeys(TRACKED, 1e3)
)
"""Fields that `meas` may have, with the largest magnitude of each: rad, rad/s, N.m, m."""


@dataclass(frozen=True)
class Message:
    """A message that has been checked. `extra` has what is not a scalar of the unit: path of a forecast, cause of an alarm."""

    kind: str
    unit: str
    time: int
    seq: int
    fields: dict[str, float]
    extra: dict[str, Any] = field(default_factory=dict)


def topic(unit: str, kind: str) -> str:
    """Where messages of that kind go."""
    return f"fivebar/{unit}/{kind}"


def encode(message: Message) -> bytes:
    """The message as it is sent: the same message, the same bytes. Numbers have the digits that give them back to the bit."""
    content = {
        "measurement": message.kind,
        "time": message.time,
        "seq": message.seq,
        "tags": {"unit": message.unit},
        "fields": message.fields,
    }
    return json.dumps(content | message.extra, allow_nan=False, separators=(",", ":")).encode()


def decode(from_topic: str, payload: bytes) -> Message:
    """The message, or `Refused` with one sentence."""
    prefix, _, rest = from_topic.partition("/")
    unit, _, kind = rest.partition("/")
    _require(prefix == "fivebar" and kind in KINDS and UNIT_NAME.fullmatch(unit) is not None, f"topic {from_topic[:100]!r} is not fivebar/UNIT/KIND")
    most = LARGEST.get(kind, LARGEST_USUAL)
    _require(len(payload) <= most, f"{kind} of {len(payload)} bytes; at most {most} are taken")
    content = _parse(kind, payload)
    _require(content.get("measurement") == kind, f"measurement is {_show(content.get('measurement'))}, not {kind}, the end of its topic")
    tags = content.get("tags")
    _require(isinstance(tags, dict) and tags.get("unit") == unit, f"tags are {_show(tags)}; the unit of this topic is {unit!r}")
    time = _integer(content, "time", LATEST)
    seq = _integer(content, "seq", MOST_SAMPLES)
    fields = content.get("fields")
    if not isinstance(fields, dict):
        raise Refused(f"fields are {_show(fields)}, not an object")
    extra = {name: value for name, value in content.items() if name not in ("measurement", "time", "seq", "tags", "fields")}
    _CHECKS[kind](fields, extra)
    return Message(kind, unit, time, seq, fields, extra)


def _parse(kind: str, payload: bytes) -> dict[str, Any]:
    try:
        content = json.loads(payload.decode("utf-8"), parse_constant=_no_constant, object_pairs_hook=_no_doubles)
    except Refused:
        raise
    except (ValueError, RecursionError) as error:
        raise Refused(f"{kind} is not JSON: {str(error)[:100]}") from None
    _require(isinstance(content, dict), f"{kind} is {_show(content)}, not an object")
    return content


def _no_constant(name: str) -> float:
    raise Refused(f"{name} is no number of JSON")


def _no_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    _require(len(content) == len(pairs), "a name stands twice in an object")
    return content


def _integer(content: dict[str, Any], name: str, largest: int) -> int:
    value = content.get(name)
    # JSON's true is an int of Python, and none of ours.
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= largest:
        raise Refused(f"{name} is {_show(value)}, not an integer from 0 to {largest}")
    return value


def number(name: str, value: Any, largest: float = math.inf) -> float:
    """The value as a finite number of at most that magnitude. JSON's true is none, and 1e999 is infinite."""
    _require(type(value) in (int, float), f"{name} is {_show(value)}, not a number")
    # An integer of many digits has no double.
    _require(abs(value) <= 1e308 and math.isfinite(value), f"{name} is {_show(value)}, not a finite number")
    _require(abs(value) <= largest, f"{name} is {_show(value)}; its magnitude is at most {largest:g}")
    return float(value)


def _meas(fields: dict[str, Any], extra: dict[str, Any]) -> None:
    unknown = fields.keys() - MEAS_RANGES.keys()
    _require(not unknown, f"meas has the field {_show(min(unknown, default=None))}, which it may not have")
    for name, value in fields.items():
        fields[name] = number(name, value, MEAS_RANGES[name])
    _require(any(name in fields for name in MEASURED), "meas has neither measured.theta[1] nor measured.theta[2]")
    _require(not extra, f"meas has {_show(min(extra, default=None))} beside its fields")


def _param(fields: dict[str, Any], extra: dict[str, Any]) -> None:
    _require(0 < len(fields) <= 64, f"param has {len(fields)} fields, not 1 to 64")
    for name, value in fields.items():
        fields[name] = number(name[:64], value)
    _require(not extra, f"param has {_show(min(extra, default=None))} beside its fields")


def _cmd(fields: dict[str, Any], extra: dict[str, Any]) -> None:
    _require(not fields and extra.keys() == {"command"}, "cmd has one command and empty fields")
    _require(extra["command"] in COMMANDS, f"command is {_show(extra['command'])}, not one of {', '.join(COMMANDS)}")


def _from_twin(fields: dict[str, Any], _extra: dict[str, Any]) -> None:
    for name, value in fields.items():
        fields[name] = number(name[:64], value)


def _est(fields: dict[str, Any], extra: dict[str, Any]) -> None:
    _from_twin(fields, extra)
    inputs = extra.get("inputs")
    _require(
        isinstance(inputs, list) and all(isinstance(one, list) and tuple(map(type, one)) == (str, int, int) for one in inputs),
        f"inputs are {_show(inputs)}, not a list of kind, seq and time",
    )


_CHECKS: Final = dict.fromkeys(KINDS, _from_twin) | {"meas": _meas, "param": _param, "cmd": _cmd, "est": _est}


def _show(value: Any) -> str:
    """What was found, in a line's length whatever it is."""
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > 10**40:
        return "an integer of very many digits"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _require(holds: bool, sentence: str) -> None:
    if not holds:
        raise Refused(sentence)
