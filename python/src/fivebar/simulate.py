"""Runs a scene through FMPy."""

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import fmpy
from fmpy.model_description import ModelDescription

from fivebar import scene as scenes
from fivebar import shipped
from fivebar.drive import Progress, Run, StartRefused, drive
from fivebar.errors import FiveBarError, StepFailed
from fivebar.result import READ, Result
from fivebar.scene import Scene
from fivebar.slave import computed
from fivebar.variables import chosen, of_unit, shown

OnFailure = Literal["raise", "return"]
"""Behaviour if a run ends early: raise StepFailed, or return the incomplete result."""


def run(
    scene: str | Path | Mapping[str, Any] | Scene,
    fmu: Path | None = None,
    overlays: bool = False,
    progress: Callable[[str, float], Progress] | None = None,
    outputs: str | Iterable[str] = (),
    on_failure: OnFailure = "raise",
) -> Result:
    """Runs a scene; `progress` makes a progress line from a label and a stop time, s.

    `outputs` selects the columns of the tables by names or prefixes; the default is all columns. Raises FiveBarError if the
    scene or an output is refused, and StepFailed if the scene's own run ends early and `on_failure` is "raise".
    """
    check(on_failure)
    unit = shipped.unit() if fmu is None else fmu
    ready = scenes.read(scene, of_unit(unit))
    with extracted(unit) as directory:
        result = run_in(directory, ready, overlays, progress, outputs)
    if on_failure == "raise" and (failure := failed(result)):
        raise failure
    return result


@contextmanager
def extracted(unit: Path) -> Iterator[str]:
    """Extracts a unit to a temporary folder and removes it at the end."""
    directory = fmpy.extract(str(unit))
    try:
        yield directory
    finally:
        shutil.rmtree(directory, ignore_errors=True)


def run_in(
    directory: str,
    scene: Scene,
    overlays: bool = False,
    progress: Callable[[str, float], Progress] | None = None,
    outputs: str | Iterable[str] = (),
) -> Result:
    """Runs a scene with the extracted unit in a folder. An early end is not an error here."""
    ready = scene.with_method()
    runs: list[Run] = []
    refused = []
    model = _model(directory)
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
    return Result(ready, runs, refused, [name for name in runs[0].columns if name in written])


# Cached, since reading the model description takes as long as a short run.
@lru_cache(maxsize=1)
def _model(directory: str) -> ModelDescription:
    return fmpy.read_model_description(directory, validate=False)


def failed(result: Result) -> StepFailed | None:
    """The error for a run that ended early, or None."""
    if result.failure is None:
        return None
    end = f"after t = {result.time[-1]:g} s of {result.own.stop_time:g} s"
    return StepFailed(f"{result.scene.name} ended early, {end}: {result.failure}", result)


def check(on_failure: str) -> None:
    """Raises FiveBarError if `on_failure` has no allowed value."""
    if on_failure not in ("raise", "return"):
        raise FiveBarError(f"'on_failure' must be one of raise, return, not {shown(on_failure)}")
