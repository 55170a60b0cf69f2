"""Runs a scene."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, get_args

from fivebar import arguments
from fivebar import scene as scenes
from fivebar.drive import Progress, Run, StartRefused, drive
from fivebar.errors import FiveBarError, StepFailed
from fivebar.library import Library, shared
from fivebar.result import READ, Result
from fivebar.scene import Scene
from fivebar.variables import chosen, shown

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
    library = shared(fmu)
    result = run_by(library, scenes.read(scene, library.known), overlays, progress, outputs)
    if on_failure == "raise" and (failure := failed(result)):
        raise failure
    return result


def run_by(
    library: Library,
    scene: Scene,
    overlays: bool = False,
    progress: Callable[[str, float], Progress] | None = None,
    outputs: str | Iterable[str] = (),
) -> Result:
    """Runs a scene with an extracted unit. An early end is not an error here."""
    ready = scene.with_method()
    runs: list[Run] = []
    refused = []
    known = ["time", *library.known.computed, *ready.signals]
    wanted = arguments.names("outputs", outputs)
    written = {"time", *chosen(wanted, known)} if wanted else set(known)
    read = written.union(chosen(READ, known))
    for variant in ready.variants if overlays else ready.variants[:1]:
        line = progress(f"{ready.name} ({variant.label})", ready.stop_time) if progress else None
        try:
            runs.append(drive(library, ready, variant, line, read))
        except StartRefused as sentence:
            if not runs:
                raise
            refused.append(f"{variant.label} did not start: {sentence}")
    return Result(ready, runs, refused, [name for name in runs[0].columns if name in written])


def failed(result: Result) -> StepFailed | None:
    """The error for a run that ended early, or None."""
    if result.failure is None:
        return None
    end = f"after t = {result.time[-1]:g} s of {result.own.stop_time:g} s"
    return StepFailed(f"{result.scene.name} ended early, {end}: {result.failure}", result)


def check(on_failure: str) -> None:
    """Raises FiveBarError if `on_failure` has no allowed value."""
    if not isinstance(on_failure, str) or on_failure not in get_args(OnFailure):
        raise FiveBarError(f"'on_failure' must be one of raise, return, not {shown(on_failure)}")
