"""Scenes made up for tests, as `cargo xtask package` writes those of scenes/."""

import json
from pathlib import Path

from fivebar.scene import Scene, Values, Variant

METHODS = {"i3alp": 1, "i3alpPrinted": 2, "rk4": 3, "dop853": 4, "i3alpConserving": 5, "automatic": 6}


def made_scene(values: Values, stop_time: float, step_size: float = 1e-3, *overlays: Variant, description: str = "trial") -> Scene:
    """A scene that sets `values` for the default method."""
    return Scene("trial", description, stop_time, step_size, [Variant("i3alp", values), *overlays])


def write(path: Path, scene: Scene) -> Path:
    """Writes a scene, under the name of the file."""
    content = {
        "name": path.stem,
        "description": scene.description,
        "stopTime": scene.stop_time,
        "stepSize": scene.step_size,
        "variants": [{"label": variant.label, "values": variant.values} for variant in scene.variants],
        "signals": {name: values.tolist() for name, values in scene.signals.items()},
    }
    path.write_text(json.dumps(content), encoding="utf-8")
    return path
