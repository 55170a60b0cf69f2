"""Scenes as `cargo xtask package` writes them to target/scenes/: start values by name, and the inputs that change.

Names, units and meanings are those of the unit's variables.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Value = float | int | bool

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
class Scene:
    """A scene: what differs from the start values, and the inputs that change, sampled at the communication points."""

    name: str
    stop_time: float
    step_size: float
    values: Mapping[str, Value]
    signals: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Value:
        """The value of a variable: that of the scene, or else the unit's start value."""
        return self.values.get(name, START[name])

    @property
    def time(self) -> NDArray[np.float64]:
        """Communication points, s: 0, H, 2H, ... and the stop time."""
        count = max(1, int(np.ceil(self.stop_time / self.step_size - 1e-9)))
        points = np.arange(count + 1) * self.step_size
        points[-1] = self.stop_time
        return points


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
        stop_time=content["stopTime"],
        step_size=content["stepSize"],
        values=content["variants"][0]["values"],
        signals={signal: np.array(values, dtype=np.float64) for signal, values in content["signals"].items()},
    )
