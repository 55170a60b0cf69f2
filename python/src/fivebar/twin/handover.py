"""Hands over what a twin has learned: the scene of its run with learned start values, for a unit of one's own, a calibration, a next run."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from fivebar import scene_file
from fivebar.scene import write_content
from fivebar.twin.calibrate.parameters import SWITCHES

TOLD: Final = "Masses, payload, friction and lengths as a twin has learned them."
"""Sentence at the end of the scene's description."""


def write(file: Path, source: Path, values: Mapping[str, float]) -> None:
    """Writes the scene in the file `source` with learned start values, and what they need switched on.

    A variable to which the scene gives a signal keeps it.
    """
    content = scene_file.parse(scene_file.text(source))
    learned = {name: value for name, value in values.items() if name not in content.get(scene_file.SIGNALS, {})}
    switches = {SWITCHES[word]: True for word in (name.partition(".")[0] for name in learned) if word in SWITCHES}
    before = content[scene_file.DESCRIPTION].removesuffix(TOLD).rstrip()
    write_content(file, content | switches | learned | {scene_file.DESCRIPTION: f"{before} {TOLD}"})
