"""Writes the scene of a run with the learned start values, for a unit of one's own, a calibration or another run.

Lengths and encoder mounting angles are written together, because neither is right without the other. All other angles of a scene are true
angles: the start angles and servo angles change with the mounting angles, so that encoder readings and drive commands stay the same.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from fivebar import scene_file
from fivebar.scene import write_content
from fivebar.twin.calibrate.parameters import SWITCHES

LEARNED: Final = "Masses, payload, friction, lengths and mounting angles as a twin has learned them."
"""Sentence appended to the scene's description."""


def write(file: Path, source: Path, values: Mapping[str, float]) -> None:
    """Writes the scene from the file `source` with learned start values, and switches on the effects that they need.

    Variables with a signal in the scene keep it.
    """
    content = scene_file.parse(scene_file.text(source))
    signals = content.get(scene_file.SIGNALS, {})
    learned = {name: value for name, value in values.items() if name not in signals}
    switches = {SWITCHES[word]: True for word in (name.partition(".")[0] for name in learned) if word in SWITCHES}
    before = content[scene_file.DESCRIPTION].removesuffix(LEARNED).rstrip()
    turned = _turned(
        content,
        {
            i: values.get(key, 0.0) - content.get(key, 0.0)
            for i, key in enumerate(scene_file.OFFSETS, 1)
            if key in values
        },
    )
    write_content(file, content | turned | switches | learned | {scene_file.DESCRIPTION: f"{before} {LEARNED}"})


def _turned(content: Mapping[str, Any], by: Mapping[int, float]) -> dict[str, Any]:
    """Start angles and servo angles of a scene, reduced by the change `by` of each encoder's mounting angle, rad."""
    signals = dict(content.get(scene_file.SIGNALS, {}))
    turned: dict[str, Any] = {}
    for i, angle in by.items():
        turned |= {name: content[name] - angle for name in (f"init.theta[{i}]", f"servo.theta[{i}]") if name in content}
        for kind, knots in signals.get(f"servo.theta[{i}]", {}).items():
            signals[f"servo.theta[{i}]"] = {kind: [[time, value - angle] for time, value in knots]}
    return turned | ({scene_file.SIGNALS: signals} if signals else {})
