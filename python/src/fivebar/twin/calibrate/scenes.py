"""Scenes as start values for calibrations and ensembles."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from fivebar import scene as scenes
from fivebar.library import Library
from fivebar.twin import record
from fivebar.twin.calibrate.parameters import Values
from fivebar.twin.errors import TwinError
from fivebar.twin.setup import of_message

KEPT_OUT: Final = ("estimator.", "solver.", "measured.")
"""First words of variables that configure the computation, not the machine."""


Given = str | Path | Mapping[str, Any] | scenes.Scene
"""A scene as `fivebar.run` takes it."""


def start_values(given: Given | None, data: Any, library: Library) -> tuple[Values, str]:
    """Start values assumed of the machine and its encoders' mounting angles, and their source: a scene, or the record's message about its run."""
    if given is not None:
        scene = scenes.read(given, library.known)
        name = given if isinstance(given, (str, Path)) else scene.name
        return _of_machine(scene.values | dict(scene.offsets)), f"scene {name}"
    if isinstance(data, Path) and record.is_record(data):
        try:
            setup = of_message(record.setup(data))
        except TwinError:
            return {}, "the unit's own start values"
        return _of_machine(setup.values | setup.scene.offsets), f"scene {setup.scene.name} of the record"
    return {}, "the unit's own start values"


def values(given: Given, library: Library) -> Values:
    """Values of the machine in a scene, by its name or file."""
    return _of_machine(scenes.read(given, library.known).values)


def _of_machine(given: Values) -> Values:
    return {name: value for name, value in given.items() if not name.startswith(KEPT_OUT)}


def series(description: Sequence[str]) -> str:
    """A list of names for a sentence."""
    return (
        ", ".join(description[:-1]) + (" and " if len(description) > 1 else "") + description[-1]
        if description
        else "nothing"
    )
