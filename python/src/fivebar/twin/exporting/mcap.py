"""Writes MCAP files for Foxglove: numbers as JSON, the scene as `foxglove.SceneUpdate`, sentences as `foxglove.Log`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import foxglove
from foxglove import messages
from foxglove.channels import LogChannel, SceneUpdateChannel

from fivebar.twin.exporting.work import Line, plain

FRAME: Final = "machine"
"""Frame of the scene: origin at the left motor, x to the right one."""

WIDTH: Final = 2.0
"""Width of a line, pixels."""


class Writer:
    """A file of MCAP."""

    def __init__(self, file: Path):
        # A context of its own, so that nothing else reaches the file.
        self.context = foxglove.Context()
        self.file = foxglove.open_mcap(file, allow_overwrite=True, context=self.context)
        self.scene = SceneUpdateChannel("/scene", context=self.context)
        self.log = LogChannel("/log", context=self.context)
        self.series: dict[str, Any] = {}

    def numbers(self, topic: str, time: int, values: Mapping[str, float]) -> None:
        """Adds a message to the topic; the first one defines it, and later ones may have more names."""
        if topic not in self.series:
            schema = {
                "type": "object",
                "title": topic,
                "properties": {plain(name): {"type": "number"} for name in values},
            }
            self.series[topic] = foxglove.Channel(f"/{topic}", schema=schema, context=self.context)
        self.series[topic].log({plain(name): value for name, value in values.items()}, log_time=time)

    def lines(self, name: str, time: int, lines: list[Line]) -> None:
        """Replaces an entity of the scene."""
        shown = [
            messages.LinePrimitive(
                type=messages.LinePrimitiveLineType.LineStrip,
                thickness=WIDTH,
                scale_invariant=True,
                points=[messages.Point3(x=point.real, y=point.imag, z=0.0) for point in line.points],
                color=messages.Color(**dict(zip("rgb", _rgb(line.colour), strict=True)), a=1.0),
            )
            for line in lines
        ]
        entity = messages.SceneEntity(timestamp=_stamp(time), frame_id=FRAME, id=name, lines=shown)
        self.scene.log(messages.SceneUpdate(entities=[entity]), log_time=time)

    def sentence(self, time: int, text: str, is_alarm: bool) -> None:
        """Adds an entry of the log."""
        level = messages.LogLevel.Warning if is_alarm else messages.LogLevel.Info
        self.log.log(messages.Log(timestamp=_stamp(time), level=level, message=text, name="twin"), log_time=time)

    def close(self) -> None:
        """Writes the index at the end of the file."""
        self.file.close()


def _stamp(time: int) -> Any:
    return messages.Timestamp(sec=time // 10**9, nsec=time % 10**9)


def _rgb(colour: str) -> list[float]:
    return [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
