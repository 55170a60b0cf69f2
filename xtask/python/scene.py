"""Scenes as `cargo xtask package` writes them to target/scenes/: checked by the workspace's crate `scenes`, values as calls carry
them, signals as they are at each communication point. docs/effects.md describes the files of scenes/.
"""

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from fmpy.model_description import ScalarVariable

Values = dict[str, float | int | bool]


@dataclass(frozen=True)
class Variant:
    """One run of a scene: a label for the pictures and the start values (enumerations as integers)."""

    label: str
    values: Values


@dataclass(frozen=True)
class Scene:
    """A scene. `variants[0]` is the scene itself, the others are its overlays; `signals` are the inputs that change, by name."""

    name: str
    description: str
    stop_time: float
    step_size: float
    variants: list[Variant]
    signals: dict[str, np.ndarray] = field(default_factory=dict)

    def coarser(self, step_size: float, stop_time: float = math.inf) -> "Scene":
        """The scene up to `stop_time`, with as few of its own steps in one as last `step_size`."""
        stride = max(1, math.ceil(step_size / self.step_size - 1e-9))
        short = replace(self, stop_time=min(self.stop_time, stop_time), step_size=stride * self.step_size)
        rows = stride * np.arange(len(communication_points(short.stop_time, short.step_size)))
        return replace(short, signals={name: values[np.minimum(rows, len(values) - 1)] for name, values in self.signals.items()})


def read(path: Path) -> Scene:
    """The scene in a file of target/scenes/."""
    content = json.loads(path.read_text(encoding="utf-8"))
    if "variants" not in content:
        raise SystemExit(f"{path} is not as `cargo xtask package` writes scenes to target/scenes/.")
    return Scene(
        name=content["name"],
        description=content["description"],
        stop_time=content["stopTime"],
        step_size=content["stepSize"],
        variants=[Variant(variant["label"], variant["values"]) for variant in content["variants"]],
        signals={name: np.array(values) for name, values in content["signals"].items()},
    )


def communication_points(stop_time: float, step_size: float) -> np.ndarray:
    """0, H, 2H, ... and the stop time; a remainder within rounding is no step of its own."""
    count = max(1, math.ceil(stop_time / step_size - 1e-9))
    points = np.arange(count + 1) * step_size
    points[-1] = stop_time
    return points


def unit(variable: ScalarVariable) -> str:
    """The unit of a variable, "1" if it has none."""
    return variable.unit or getattr(variable.declaredType, "unit", None) or "1"
