"""Scenes made up for tests, and written as users write them."""

import json
from pathlib import Path
from xml.etree import ElementTree

from fivebar.scene import Scene, Variant
from fivebar.variables import Values, of_unit

_XML = ElementTree.parse(Path(__file__).parents[2] / "modelDescription" / "modelDescription.xml")
METHODS = {
    item.attrib["name"]: int(item.attrib["value"]) for item in _XML.iterfind(".//SimpleType[@name='Method']//Item")
}
"""The methods' numbers."""


def made_scene(
    values: Values, stop_time: float, step_size: float = 1e-3, *overlays: Variant, description: str = "trial"
) -> Scene:
    """A scene that sets `values` for the default method."""
    return Scene("trial", description, stop_time, step_size, [Variant("i3alp", values), *overlays])


def write(path: Path, scene: Scene) -> Path:
    """Writes a scene, under the name of the file; signals have a knot at each communication point."""
    content = {
        "description": scene.description,
        "experiment": {"stopTime": scene.stop_time, "stepSize": scene.step_size},
        **_words(scene.values),
        "overlay": [{"label": variant.label} | _words(variant.values) for variant in scene.variants[1:]],
        "signals": {
            name: {"linear": list(zip(scene.time.tolist(), values.tolist()))} for name, values in scene.signals.items()
        },
    }
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def _words(values: Values) -> dict[str, object]:
    """Enumerations by the names of their items."""
    known = of_unit()
    return {
        name: known[name].item(int(value)) if known[name].type == "Enumeration" else value
        for name, value in values.items()
    }


TABLE = {
    "base.distance": 0.1,
    "gravity.enabled": False,
    "servo.enabled": True,
    "servo.kp[1]": 20,
    "servo.kp[2]": 20,
    "servo.kd[1]": 0.5,
    "servo.kd[2]": 0.5,
}
"""A robot on a table, moved by servos."""

UNEVEN = {
    "base.distance": 0.25,
    "link[1].length": 0.2,
    "link[2].length": 0.3,
    "link[3].length": 0.22,
    "link[4].length": 0.17,
}
"""Links of four lengths."""
