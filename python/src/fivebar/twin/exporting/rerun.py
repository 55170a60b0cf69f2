"""Writes files for Rerun's viewer: each number as a series of its own, the scene as lines in 3D, sentences as a log."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import rerun as rr

from fivebar.twin.exporting.work import Line, plain

TIME: Final = "time"
"""The timeline."""


class Writer:
    """A file of Rerun."""

    def __init__(self, file: Path):
        self.file = rr.RecordingStream("fivebar")
        self.file.save(file)
        self.file.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self.series: dict[str, tuple[list[int], list[float]]] = {}

    def numbers(self, topic: str, time: int, values: Mapping[str, float]) -> None:
        """Adds a point to the series of each name; they are written at the end, which is much faster."""
        for name, value in values.items():
            times, numbers = self.series.setdefault(f"{topic}/{plain(name)}", ([], []))
            times.append(time)
            numbers.append(value)

    def lines(self, name: str, time: int, lines: list[Line]) -> None:
        """Replaces a part of the scene."""
        self.file.set_time(TIME, timestamp=np.datetime64(time, "ns"))
        strips = [[(point.real, point.imag, 0.0) for point in line.points] for line in lines]
        colours = [int(line.colour[1:] + "ff", 16) for line in lines]
        self.file.log(f"scene/{name}", rr.LineStrips3D(strips, colors=colours))

    def sentence(self, time: int, text: str, is_alarm: bool) -> None:
        """Adds an entry of the log."""
        self.file.set_time(TIME, timestamp=np.datetime64(time, "ns"))
        self.file.log("log", rr.TextLog(text, level="WARN" if is_alarm else "INFO"))

    def close(self) -> None:
        """Writes the series and completes the file."""
        for path, (times, numbers) in self.series.items():
            index = rr.TimeColumn(TIME, timestamp=np.array(times, dtype="datetime64[ns]"))
            self.file.send_columns(path, indexes=[index], columns=rr.Scalars.columns(scalars=numbers))
        self.file.disconnect()
