"""`fivebar export RECORD`: passes the messages of a record to writers, as series of numbers, lines of a scene, and sentences.

Times are those of the messages, ns since 1970 on the machine's clock. The tip of a forecast stands at the time that it is for, so that it lies over
the estimate of that time.
"""

import cmath
import math
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from fivebar.colours import LEFT, RIGHT, TIP
from fivebar.kinematics import GEOMETRY, Machine
from fivebar.twin import record, setup
from fivebar.twin.forecast import covariance, half_width
from fivebar.twin.messages import TRACKED, Message

AHEAD: Final = "#6c757d"
"""Colour of the path of a forecast."""

CIRCLE: Final = [cmath.exp(2j * math.pi * k / 32) for k in range(33)]
"""Points of a band about the tip."""

KINDS: Final = ("meas", "est", "forecast", "alarm", "learned", "gap")


class Line(NamedTuple):
    """A line of the scene."""

    points: list[complex]
    """x + iy, m."""

    colour: str
    """As #rrggbb."""


class Writer(Protocol):
    """Writes a file of a viewer's format."""

    def numbers(self, topic: str, time: int, values: Mapping[str, float]) -> None:
        """Adds a point of time series."""

    def lines(self, name: str, time: int, lines: list[Line]) -> None:
        """Replaces the part `name` of the scene."""

    def sentence(self, time: int, text: str, is_alarm: bool) -> None:
        """Adds an entry of the log."""

    def close(self) -> None:
        """Completes the file."""


@dataclass
class Written:
    """Numbers of written messages and refused rows."""

    messages: int = 0
    refused: int = 0


def plain(name: str) -> str:
    """The name of a variable as both viewers can select it: `estimated.nis`, `theta[1]` become `estimated_nis`, `theta_1`."""
    return name.replace(".", "_").replace("[", "_").replace("]", "")


def machine(file: Path) -> Machine:
    """The machine of the recorded run; its lengths are those of the scene."""
    scene = setup.of_message(record.setup(file)).scene
    return Machine.from_values({name: float(scene.values[name]) for name in GEOMETRY if name in scene.values})


def write(file: Path, of: Machine, *writers: Writer) -> Written:
    """Reads the record once, passes all messages to each writer, and closes the writers."""
    written = Written()

    def refused(_: str) -> None:
        written.refused += 1

    with ExitStack() as stack:
        for writer in writers:
            stack.callback(writer.close)
        for message in record.messages(file, *KINDS, refused=refused):
            written.messages += 1
            for writer in writers:
                _pass(message, of, writer)
    return written


def _pass(message: Message, of: Machine, writer: Writer) -> None:
    fields, extra, time = message.fields, message.extra, message.time
    if message.kind == "est":
        band = {"band": half_width(covariance(fields))} if "estimated.tip.cov[1]" in fields else {}
        writer.numbers("est", time, fields | band)
        writer.lines("twin", time, _legs(of, fields))
        writer.lines("band", time, [_circle(_tip(fields), band["band"])] if band else [])
    elif message.kind == "meas":
        writer.numbers("meas", time, fields)
        if all(name in fields for name in TRACKED):
            # A circle of a millimetre, as a point has no size in a scene.
            writer.lines("tracked", time, [_circle(_tip(fields), 1e-3)])
    elif message.kind == "forecast":
        tip, radius = _tip(fields), float(extra["half_width"])
        forecast = {"tip.x": tip.real, "tip.y": tip.imag, "half_width": radius}
        writer.numbers("forecast", time + round(1e9 * extra["ahead"]), forecast)
        path = [complex(x, y) for x, y in zip(extra["path"]["tip.x"], extra["path"]["tip.y"], strict=True)]
        writer.lines("forecast", time, [Line(path, AHEAD), _circle(tip, radius)])
        risks = {f"{name}.probability": float(extra[name]["probability"]) for name in ("singular", "stop")}
        writer.numbers("risk", time, risks)
    elif message.kind == "learned":
        writer.numbers("learned", time, fields)
    elif message.kind == "alarm":
        parts = [
            str(extra[name])
            for name in ("state", "named" if "named" in extra else "cause", "sentence")
            if name in extra
        ]
        is_alarm = extra["state"] in ("anomaly", "trouble")
        writer.numbers("alarm", time, {"anomaly": float(extra["state"] == "anomaly")})
        writer.sentence(time, ": ".join(parts), is_alarm)
    else:
        lost = f"{extra['of']} {fields['first']:.0f} to {fields['last']:.0f} are missing"
        writer.sentence(time, ": ".join([lost, *([extra["why"]] if "why" in extra else [])]), False)


def _tip(fields: Mapping[str, float]) -> complex:
    return complex(fields["tip.x"], fields["tip.y"])


def _legs(of: Machine, fields: Mapping[str, float]) -> list[Line]:
    """Both legs, from motor by elbow to tip."""
    left, right = cmath.rect(of.lengths[0], fields["theta[1]"]), cmath.rect(of.lengths[3], fields["theta[2]"])
    tip, motor = _tip(fields), complex(of.distance)
    return [Line([0j, left, tip], LEFT), Line([motor, motor + right, tip], RIGHT)]


def _circle(centre: complex, radius: float) -> Line:
    return Line([centre + radius * point for point in CIRCLE], TIP)
