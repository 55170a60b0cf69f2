"""Runs a scene through FMPy."""

import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Literal

import fmpy

from fivebar import scene as scenes
from fivebar import shipped
from fivebar.drive import Progress, Run, StartRefused, drive
from fivebar.errors import FiveBarError, StepFailed
from fivebar.result import READ, Result
from fivebar.scene import Scene
from fivebar.slave import computed
from fivebar.variables import chosen, of_unit, shown

OnFailure = Literal["raise", "return"]
"""What becomes of a run that ends early: a StepFailed, or its short result."""


def run(
    scene: str | Path | Scene,
    fmu: Path | None = None,
    overlays: bool = False,
    progress: Callable[[str, float], Progress] | None = None,
    outputs: str | Iterable[str] = (),
    on_failure: OnFailure = "raise",
) -> Result:
    """Runs a scene; `progress` makes a line for a label and a stop time, s.

    `outputs` are the columns of the tables, by their names or how these begin; without them there are all.
    Raises FiveBarError if the scene or an output is refused, and StepFailed if the scene's own run ends early, unless the short result is
    wanted.
    """
    check(on_failure)
    unit = shipped.unit() if fmu is None else fmu
    ready = scenes.read(scene, of_unit(unit)).with_method()
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
    result = Result(ready, runs, refused, [name for name in runs[0].columns if name in written])
    if result.failure is not None and on_failure == "raise":
        raise StepFailed(
            f"{ready.name} ended early, after t = {result.time[-1]:g} s of {ready.stop_time:g} s: {result.failure}",
            result,
        )
    return result


def check(on_failure: str) -> None:
    """Refuses a word for what becomes of a run that ends early."""
    if on_failure not in ("raise", "return"):
        raise FiveBarError(f"'on_failure' must be one of raise, return, not {shown(on_failure)}")
