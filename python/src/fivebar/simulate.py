"""Runs a scene through FMPy."""

import shutil
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import fmpy

from fivebar import scene as scenes
from fivebar import scene_file, shipped
from fivebar.drive import Progress, Run, StartRefused, drive
from fivebar.errors import FiveBarError
from fivebar.result import READ, Result
from fivebar.scene import Scene
from fivebar.slave import computed
from fivebar.variables import chosen, of_unit


def run(
    scene: str | Path | Scene,
    method: str | None = None,
    values: Mapping[str, Any] | None = None,
    fmu: Path | None = None,
    overlays: bool = False,
    progress: Callable[[str, float], Progress] | None = None,
    outputs: Iterable[str] = (),
) -> Result:
    """Runs a scene, by another method or with other start values if they are given; `progress` makes a line for a label and a stop time, s.

    `outputs` are the columns of the tables, by their names or how these begin; without them there are all.
    Raises FiveBarError if the scene, the method, a value or an output is refused.
    """
    unit = shipped.unit() if fmu is None else fmu
    variables = of_unit(unit)
    for name in values or {}:
        if name.replace("_", "").lower() in (key.lower() for key in scene_file.SECONDS):
            raise FiveBarError(
                f"{name!r} is no variable: stopTime and stepSize, s, stand in the key 'experiment' of a scene's file"
            )
    ready = scene if isinstance(scene, Scene) else scenes.read(scene, variables)
    given = dict(values or {}) | ({} if method is None else {"solver.method": method})
    if given:
        ready = ready.changed(given, variables)
    directory = fmpy.extract(str(unit))
    runs: list[Run] = []
    refused = []
    try:
        model = fmpy.read_model_description(directory, validate=False)
        known = ["time", *(v.name for v in computed(model)), *ready.signals]
        wanted = [outputs] if isinstance(outputs, str) else list(outputs)
        written = {"time", *chosen(wanted, known)} if wanted else set(known)
        read = written.union(chosen(READ, known))
        for variant in ready.variants if overlays else ready.variants[:1]:
            line = progress(f"{ready.name} ({variant.label})", ready.stop_time) if progress else None
            try:
                runs.append(drive(model, directory, ready, variant, line, read))
            except StartRefused as sentence:
                if not runs:
                    raise
                refused.append(f"{variant.label} did not start: {sentence}")
    finally:
        shutil.rmtree(directory, ignore_errors=True)
    return Result(ready, runs, refused, [name for name in runs[0].columns if name in written])
