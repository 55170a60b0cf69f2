"""Scenes as start values for calibrations and ensembles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from fivebar import scene as scenes
from fivebar.library import Library
from fivebar.twin import record
from fivebar.twin.calibrate.parameters import Values
from fivebar.twin.errors import TwinError
from fivebar.twin.setup import of_message

SETTINGS: Final = ("estimator.", "solver.")
"""First words of variables that configure the computation, not the machine."""

KEPT_OUT: Final = (*SETTINGS, "measured.")
"""First words of variables that do not describe the machine."""


Given = str | Path | Mapping[str, Any] | scenes.Scene
"""A scene as `fivebar.run` takes it."""


@dataclass(frozen=True)
class Assumed:
    """What a calibration assumes."""

    source: str
    """Source of the values, in words."""

    machine: Values = field(default_factory=dict)
    """Values of the machine and the mounting angles of its encoders that differ from the unit's start values."""

    settings: Values = field(default_factory=dict)
    """Settings of estimator and solver, for the scene of the calibrated machine."""


def assumed(given: Given | None, data: Any, library: Library) -> Assumed:
    """Values of a scene, or of the record's message about its run."""
    if given is not None:
        scene = scenes.read(given, library.known)
        name = given if isinstance(given, (str, Path)) else scene.name
        return Assumed(f"scene {name}", _of_machine(scene.values | dict(scene.offsets)), _settings(scene.values))
    if isinstance(data, Path) and record.is_record(data):
        try:
            setup = of_message(record.setup(data))
        except TwinError:
            return Assumed("the unit's own start values")
        machine = _of_machine(setup.values | setup.scene.offsets)
        return Assumed(f"scene {setup.scene.name} of the record", machine, _settings(setup.scene.values))
    return Assumed("the unit's own start values")


def values(given: Given, library: Library) -> Values:
    """Values of the machine in a scene, by its name or file."""
    return _of_machine(scenes.read(given, library.known).values)


def _of_machine(given: Values) -> Values:
    return {name: value for name, value in given.items() if not name.startswith(KEPT_OUT)}


def _settings(given: Values) -> Values:
    return {name: value for name, value in given.items() if name.startswith(SETTINGS)}


def series(description: Sequence[str]) -> str:
    """A list of names for a sentence."""
    return (
        ", ".join(description[:-1]) + (" and " if len(description) > 1 else "") + description[-1]
        if description
        else "nothing"
    )
