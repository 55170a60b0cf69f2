"""Scenes as start values: read from where they may stand, and written as `cargo xtask package --scene` takes them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from fivebar.twin import config, record
from fivebar.twin.calibrate.parameters import Values
from fivebar.twin.errors import TwinError
from fivebar.twin.setup import of_message
from fivebar.twin.unit import Library

RESERVED: Final = ("description", "experiment", "signals", "overlay")
"""Keys of a scene's file that are no variables."""

KEPT_OUT: Final = ("estimator.", "solver.", "measured.")
"""First words of variables that set the computation, and not the machine."""


def start_values(given: Path | None, data: Path, library: Library) -> tuple[Values, str]:
    """Start values assumed of the machine, and their source: a file of scenes/ or target/scenes/, or the record's message about its run."""
    if given is not None:
        file = found(given)
        return read(file, library), str(file)
    if not (data.is_file() and data.suffix.lower() == ".csv"):
        try:
            setup = of_message(record.setup(data))
        except TwinError:
            return {}, "the unit's own start values"
        values = {name: value for name, value in setup.values.items() if not name.startswith(KEPT_OUT)}
        return values, f"scene {setup.scene.name} of the record"
    return {}, "the unit's own start values"


def found(given: Path) -> Path:
    """A scene by its file, or by the name of one that `cargo xtask package` has written."""
    for file in (given, Path("target/scenes") / f"{given}.json", Path(__file__).parents[5] / "target" / "scenes" / f"{given}.json"):
        if file.is_file():
            return file
    raise TwinError(f"there is no scene {given}: neither that file nor target/scenes/{given}.json, which `cargo xtask package` writes")


def read(file: Path, library: Library) -> Values:
    """Start values of a file of target/scenes/ (resolved) or scenes/ (enumerations by the names of their items)."""
    content = config.read_json(file)
    if "variants" in content:
        try:
            values = dict(content["variants"][0]["values"])
        except (KeyError, IndexError, TypeError, ValueError):
            raise TwinError(f"{file} is not as `cargo xtask package` writes scenes to target/scenes/") from None
    else:
        values = {name: value for name, value in content.items() if name not in RESERVED}
    return {name: _value(name, value, library, file) for name, value in values.items() if not name.startswith(KEPT_OUT)}


def _value(name: str, value: Any, library: Library, file: Path) -> float | int | bool:
    variable = library.variable(name)
    if variable.type == "Enumeration" and isinstance(value, str):
        items = {item.name: int(item.value) for item in variable.declaredType.items}
        if value not in items:
            raise TwinError(f"{file}: {name} is {value!r:.60}; {', '.join(items)} are allowed")
        return items[value]
    if not isinstance(value, (int, float)):
        raise TwinError(f"{file}: {name} is {value!r:.60}, not a number")
    return value


def write(file: Path, description: str, values: Values, stop_time: float, step_size: float, library: Library, signals: dict[str, Any] | None = None) -> None:
    """Writes a scene with every value that differs from the unit's own."""
    content: dict[str, Any] = {"description": description, "experiment": {"stopTime": stop_time, "stepSize": step_size}}
    for name, value in values.items():
        variable = library.variable(name)
        if variable.type == "Boolean":
            if bool(value) != (str(variable.start).lower() == "true"):
                content[name] = bool(value)
        elif variable.type == "Enumeration":
            if int(value) != int(variable.start):
                content[name] = {int(item.value): item.name for item in variable.declaredType.items}[int(value)]
        elif float(value) != float(variable.start or 0.0):
            content[name] = float(value)
    if signals:
        content["signals"] = signals
    file.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def series(description: Sequence[str]) -> str:
    """Names in a sentence."""
    return ", ".join(description[:-1]) + (" and " if len(description) > 1 else "") + description[-1] if description else "nothing"
