"""Scenes: start values by name, inputs that change, further runs to compare with. docs/effects.md describes the files of scenes/.

A file is read, checked and resolved here, by the names, types, bounds and start values of the unit's own model description.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fivebar import scene_file, shipped
from fivebar.errors import FiveBarError
from fivebar.variables import Value, Values, Variables, of_unit

MOST_POINTS = 1_000_000
"""Communication points of a run, at most: each has a row of some 150 numbers."""


@dataclass(frozen=True)
class Variant:
    """One run of a scene: a label for the pictures and the start values (enumerations as integers)."""

    label: str
    values: Values


@dataclass(frozen=True)
class Scene:
    """A scene. `variants[0]` is the scene itself, the others are its overlays.

    `signals` are the inputs that change, by name, each sampled at the communication points: (n,), in the unit of the variable.
    """

    name: str
    description: str
    stop_time: float
    """How long it is followed, s."""

    step_size: float
    """The communication step, s."""

    variants: list[Variant]
    signals: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    start: Mapping[str, Value] = field(default_factory=lambda: of_unit().start, repr=False, compare=False)
    """The unit's own start values."""

    @property
    def values(self) -> Values:
        """Start values of the scene itself that differ from the unit's."""
        return self.variants[0].values

    def __getitem__(self, name: str) -> Value:
        """The value of a variable: that of the scene, or else the unit's start value."""
        return self.values.get(name, self.start[name])

    @property
    def time(self) -> NDArray[np.float64]:
        """Communication points, s: (n,), 0, H, 2H, ... and the stop time."""
        return communication_points(self.stop_time, self.step_size)

    def coarser(self, step_size: float, stop_time: float = math.inf) -> "Scene":
        """The scene up to `stop_time`, with as few of its own steps in one as last `step_size`."""
        stride = max(1, math.ceil(step_size / self.step_size - 1e-9))
        short = replace(self, stop_time=min(self.stop_time, stop_time), step_size=stride * self.step_size)
        rows = stride * np.arange(len(short.time))
        return replace(short, signals={name: values[np.minimum(rows, len(values) - 1)] for name, values in self.signals.items()})

    def changed(self, given: Mapping[str, Any], variables: Variables) -> "Scene":
        """The scene with other start values, enumerations by the names of their items; an overlay keeps what it changes itself."""
        new = {name: variables.settable(name).value(value) for name, value in given.items()}
        own = self.values | new
        variants = [Variant(scene_file.method(own, variables), own)]
        for overlay in self.variants[1:]:
            kept = {name: value for name, value in overlay.values.items() if self.values.get(name) != value}
            variants.append(Variant(overlay.label, own | kept))
        scene_file.check_labels([variant.label for variant in variants])
        scene_file.check_signals([variant.values for variant in variants], self.signals)
        return replace(self, variants=variants)

    def resolved(self) -> dict[str, Any]:
        """The scene with nothing left to look up, in terms of JSON: values as calls carry them, signals at every communication point."""
        return {
            "name": self.name,
            "description": self.description,
            "stopTime": self.stop_time,
            "stepSize": self.step_size,
            "variants": [{"label": variant.label, "values": variant.values} for variant in self.variants],
            "signals": {name: values.tolist() for name, values in self.signals.items()},
        }


def communication_points(stop_time: float, step_size: float) -> NDArray[np.float64]:
    """0, H, 2H, ... and the stop time, s: (n,); a remainder within rounding is no step of its own."""
    steps = stop_time / step_size - 1e-9
    if not steps < MOST_POINTS:
        raise FiveBarError(f"{stop_time} s in steps of {step_size} s are too many: up to {MOST_POINTS} communication points are allowed")
    points = np.arange(max(1, math.ceil(steps)) + 1) * step_size
    points[-1] = stop_time
    return points


def read(name: str | Path, variables: Variables | None = None) -> Scene:
    """The shipped scene of that name, or the scene in that file, which ends in .json, for the unit whose variables are given."""
    return of_file(found(name), variables)


def found(name: str | Path) -> Path:
    """The file of a scene."""
    path = Path(name)
    if path.suffix == ".json":
        return path
    files = shipped.scene_files()
    if str(name) not in files:
        raise FiveBarError(f"there is no scene {str(name)!r:.80}; there are {', '.join(files)}, and files that end in .json")
    return files[str(name)]


def of_file(file: Path, variables: Variables | None = None) -> Scene:
    """The scene in a file, named after it."""
    try:
        if not file.stem.strip(". "):
            raise FiveBarError("a scene is called as its file, whose name has dots only")
        return parse(file.stem, scene_file.text(file), variables)
    except FiveBarError as error:
        raise FiveBarError(f"{file}: {error}") from None


def parse(name: str, text: str, variables: Variables | None = None) -> Scene:
    """A scene from the text of its file."""
    variables = variables or of_unit()
    content = scene_file.Content(scene_file.parse(text), variables)
    sampled = {}
    if content.signals:
        points = communication_points(content.stop_time, content.step_size).tolist()
        sampled = {signal.variable.name: np.array([signal.at(time) for time in points]) for signal in content.signals}
    return Scene(
        name=name,
        description=content.description,
        stop_time=content.stop_time,
        step_size=content.step_size,
        variants=[
            Variant(scene_file.method(content.values, variables), content.values),
            *(Variant(label, values) for label, values in content.overlays),
        ],
        signals=sampled,
        start=variables.start,
    )


def description(file: Path) -> str:
    """Description of a scene, from its file."""
    return str(json.loads(file.read_text(encoding="utf-8"))["description"])


def write(
    file: Path,
    text: str,
    values: Mapping[str, Value],
    stop_time: float,
    step_size: float,
    variables: Variables,
    signals: Mapping[str, Any] | None = None,
) -> None:
    """Writes a scene with every value that differs from the unit's own; `text` is its description, `signals` are as files have them."""
    content: dict[str, Any] = {"description": text, "experiment": {"stopTime": stop_time, "stepSize": step_size}}
    for name, value in values.items():
        variable = variables.settable(name)
        if value != variable.start:
            content[name] = variable.item(int(value)) if variable.type == "Enumeration" else value
    if signals:
        content["signals"] = signals
    file.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
