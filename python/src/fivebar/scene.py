"""Scenes as `cargo xtask package` writes them to target/scenes/: start values by name, inputs that change, further runs to compare with.

Names, units and meanings are those of the unit's variables. docs/effects.md describes the files of scenes/.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from fmpy.model_description import ScalarVariable
from numpy.typing import NDArray

Value = float | int | bool
Values = dict[str, Value]

START: Mapping[str, Value] = {
    "base.distance": 0.42,
    **{f"link[{i}].length": 0.21 for i in range(1, 5)},
    **{f"link[{i}].mass": 0.017 for i in range(1, 5)},
    **{f"link[{i}].com": 0.105 for i in range(1, 5)},
    "gravity.enabled": True,
    "gravity.g": 9.81,
    "gravity.tilt": np.pi / 2,
    "gravity.direction": -np.pi / 2,
    "payload.enabled": False,
    "payload.mass": 0.05,
    "spring.enabled": False,
    **{f"spring.k[{i}]": 0.05 for i in (1, 2)},
    **{f"spring.theta0[{i}]": np.pi / 2 for i in (1, 2)},
    "stop.enabled": False,
    **{f"stop.lower[{i}]": 0.0 for i in (1, 2)},
    **{f"stop.upper[{i}]": np.pi for i in (1, 2)},
    "servo.enabled": False,
    **{f"servo.limit[{i}]": 1.0 for i in (1, 2)},
}
"""Start values of the unit's variables that kinematics and statics read."""


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

    @property
    def values(self) -> Values:
        """Start values of the scene itself that differ from the unit's."""
        return self.variants[0].values

    def __getitem__(self, name: str) -> Value:
        """The value of a variable: that of the scene, or else the unit's start value."""
        return self.values.get(name, START[name])

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


def communication_points(stop_time: float, step_size: float) -> NDArray[np.float64]:
    """0, H, 2H, ... and the stop time, s: (n,); a remainder within rounding is no step of its own."""
    count = max(1, math.ceil(stop_time / step_size - 1e-9))
    points = np.arange(count + 1) * step_size
    points[-1] = stop_time
    return points


def unit(variable: ScalarVariable) -> str:
    """The unit of a variable, "1" if it has none."""
    return variable.unit or getattr(variable.declaredType, "unit", None) or "1"


def target(part: str) -> Path:
    """A file or folder below `target/` of the current folder, of one above it, or else of the checkout that this package lies in."""
    roots = (Path.cwd(), *Path.cwd().parents, *Path(__file__).resolve().parents)
    for root in roots:
        if (root / "target" / part).exists():
            return root / "target" / part
    raise ValueError(f"There is no {Path.cwd() / 'target' / part}: run `cargo xtask package`.")


def read(name: str | Path) -> Scene:
    """The scene of that name, or in that file, which is as `cargo xtask package` writes it."""
    path = Path(name)
    if path.suffix != ".json":
        path = target("scenes") / f"{name}.json"
        if not path.is_file():
            known = ", ".join(sorted(file.stem for file in path.parent.glob("*.json")))
            raise ValueError(f"There is no scene {name!r}; there are {known}.")
    if not path.is_file():
        raise ValueError(f"There is no file {path}.")
    content = json.loads(path.read_text(encoding="utf-8"))
    if "variants" not in content:
        raise ValueError(f"{path} is not as `cargo xtask package` writes scenes to target/scenes/.")
    return Scene(
        name=content["name"],
        description=content["description"],
        stop_time=content["stopTime"],
        step_size=content["stepSize"],
        variants=[Variant(variant["label"], variant["values"]) for variant in content["variants"]],
        signals={signal: np.array(values, dtype=np.float64) for signal, values in content["signals"].items()},
    )
