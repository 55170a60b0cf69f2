"""The scene of a run, resolved at its begin: start values, and drive commands over time."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fivebar import scene as scenes
from fivebar import scene_file
from fivebar.twin import config
from fivebar.twin.errors import TwinError
from fivebar.twin.messages import INPUTS
from fivebar.variables import Variables

SOURCE: Final = "source.json"
"""Name of the copy of the scene's source file in the folder of a run."""


OFFSET_OF: Final = {
    f"{name}[{i}]": offset
    for i, offset in enumerate(scene_file.OFFSETS, 1)
    for name in ("measured.theta", "servo.theta", "init.theta")
}
"""Mounting angle that a field or start value includes, by the name of the field."""


@dataclass(frozen=True)
class Scene:
    """A resolved scene. Its signals repeat if they end at their first values; otherwise they keep their last values."""

    name: str
    description: str
    values: dict[str, float | int | bool]
    stop_time: float
    step_size: float
    signals: dict[str, list[float]]
    periodic: bool
    offsets: dict[str, float]
    """Known mounting angles of the encoders, rad, by their keys in a scene file. All other angles of a scene are true angles."""

    def content(self) -> dict[str, Any]:
        """The content of a file for `parse`."""
        return {
            "name": self.name,
            "description": self.description,
            "stopTime": self.stop_time,
            "stepSize": self.step_size,
            "variants": [{"label": self.name, "values": self.values}],
            "signals": self.signals,
            "offsets": self.offsets,
        }

    def shown(self, fields: Mapping[str, float]) -> dict[str, float]:
        """Converts true angles of samples and commands to encoder readings; the drives close their loops on the encoders."""
        return {name: value + self._beyond(name) for name, value in fields.items()}

    def true(self, fields: Mapping[str, float]) -> dict[str, float]:
        """Converts encoder readings of samples and commands to true angles."""
        return {name: value - self._beyond(name) for name, value in fields.items()}

    def _beyond(self, name: str) -> float:
        """Encoder reading minus true angle for a field of `meas`, rad."""
        return self.offsets.get(OFFSET_OF.get(name, ""), 0.0)

    def commands_at(self, time: float) -> dict[str, float]:
        """Drive commands at a time, s, as true angles: the values of the `messages.INPUTS` in the scene, by name."""
        return {name: self.at(name, time) for name in self.signals if name in INPUTS}

    def at(self, name: str, time: float) -> float:
        """Value of a signal at a time, s."""
        values = self.signals[name]
        place = (time % self.stop_time if self.periodic else min(max(time, 0.0), self.stop_time)) / self.step_size
        below = min(int(place + 1e-9), len(values) - 1)
        above = min(below + 1, len(values) - 1)
        return values[below] + (values[above] - values[below]) * min(max(place - below, 0.0), 1.0)


def resolve(given: str | Path, variables: Variables, folder: Path) -> Path:
    """Writes a scene, given by name or file, to the folder of a run, with all values resolved so that processes read it quickly."""
    file, source = folder / "scene.json", folder / SOURCE
    for each in (file, source):
        each.touch(mode=0o600)
    given = scenes.found(given)
    own = scenes.of_file(given, variables)
    file.write_text(json.dumps(own.resolved() | {"offsets": own.offsets}) + "\n", encoding="utf-8")
    source.write_text(scene_file.text(given), encoding="utf-8")
    return file


def read(file: Path) -> Scene:
    """Reads a scene file written by `resolve`."""
    try:
        return parse(config.read_json(file))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        raise TwinError(f"{file} is not a resolved scene in the format of this version") from None


def parse(content: dict[str, Any]) -> Scene:
    """The scene from a resolved scene file's content."""
    signals = {str(name): [float(x) for x in values] for name, values in content["signals"].items()}
    return Scene(
        name=str(content["name"]),
        description=str(content["description"]),
        values=dict(content["variants"][0]["values"]),
        stop_time=float(content["stopTime"]),
        step_size=float(content["stepSize"]),
        signals=signals,
        periodic=bool(signals) and all(abs(values[-1] - values[0]) < 1e-9 for values in signals.values()),
        # Records of older versions contain no offsets.
        offsets={str(name): float(value) for name, value in content.get("offsets", {}).items()},
    )
