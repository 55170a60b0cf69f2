"""Runs many scenes in parallel on this computer."""

import multiprocessing
import os
import pickle
import sys
import tempfile
from collections.abc import Callable, Generator, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from typing import Any

from fivebar import arguments, simulate
from fivebar import scene as scenes
from fivebar.errors import FiveBarError, StepFailed
from fivebar.library import shared
from fivebar.progress import Line
from fivebar.result import Result
from fivebar.scene import Scene
from fivebar.simulate import OnFailure
from fivebar.variables import shown

MOST_PROCESSES = 61
"""Largest number of processes in a pool on Windows."""

WORKER = "fivebar.run_many"
"""Name of the worker processes."""

Given = str | Path | Mapping[str, Any] | Scene
Reduce = Callable[[Result], Any]
Outcome = tuple[int, FiveBarError | None, Any]
"""Number of a run, its error if it is incomplete, and its result."""


def run_many(
    given: Given | Iterable[Given],
    values: Any,
    changes: Mapping[str, Any],
    outputs: str | Iterable[str] = (),
    reduce: Reduce | None = None,
    on_failure: OnFailure = "raise",
    processes: int | None = None,
    progress: bool = True,
) -> list[Any]:
    """See `fivebar.run_many`; `changes` are the other arguments of `Scene.replace`."""
    simulate.check(on_failure)
    wanted = _processors() if processes is None else arguments.count("processes", processes)
    ready = _scenes(given, values, changes)
    columns = arguments.names("outputs", outputs)
    found: list[Any] = [None] * len(ready)
    line, count = Line(), min(wanted, len(ready), MOST_PROCESSES)
    _check_reduction(reduce, count)
    try:
        tasks = [(number, scene, columns, reduce) for number, scene in enumerate(ready)]
        # Close at once: a notebook that stores an error would keep the processes alive.
        with closing((_run(task) for task in tasks) if count <= 1 else _in_processes(tasks, count)) as outcomes:
            for done, (number, failure, result) in enumerate(outcomes, 1):
                if failure is not None and on_failure == "raise":
                    raise failure
                found[number] = result if failure is None else failure
                if progress and (line.terminal or 10 * done // len(ready) > 10 * (done - 1) // len(ready)):
                    line.show(f"{done} of {len(ready)} runs")
    finally:
        line.finish()
    return found


def _check_reduction(reduce: Reduce | None, count: int) -> None:
    """Raises FiveBarError if `reduce` is not a function, or cannot be sent to `count` processes."""
    if reduce is None:
        return
    if not callable(reduce):
        raise FiveBarError(f"'reduce' must be a function of a result, not {shown(reduce)}")
    if count > 1:
        try:
            pickle.dumps(reduce)
        except (pickle.PicklingError, AttributeError, TypeError):
            raise FiveBarError(
                f"'reduce' is {reduce!r:.100}, which other processes cannot import: it must be a function defined with `def` at the top of a "
                "module; processes=1 takes any function"
            ) from None


def _scenes(given: Given | Iterable[Given], values: Any, changes: Mapping[str, Any]) -> list[Scene]:
    """One scene per run, ready to be sent to a process."""
    one = isinstance(given, (str, Path, Mapping, Scene))
    if not one and not isinstance(given, Iterable):
        raise FiveBarError(f"'scene' must be a scene or a list of scenes, not {shown(given)}")
    bases = [scenes.read(given)] if one else [scenes.read(each) for each in given]  # type: ignore[union-attr,arg-type]
    if hasattr(values, "columns") and hasattr(values, "index"):
        values = values.to_dict("records")
    if values is not None and (isinstance(values, Mapping) or not isinstance(values, Iterable)):
        raise FiveBarError(
            f"'values' must be a list of dicts or a frame of pandas, one dict or row for each run, not {shown(values)}"
        )
    overrides = [{}] * len(bases) if values is None else list(values)
    if one:
        bases *= len(overrides)
    if len(bases) != len(overrides):
        raise FiveBarError(
            f"there are {len(bases)} scenes and {len(overrides)} dicts of values: one scene, or one for each dict, is needed"
        )
    for number, own in enumerate(overrides):
        if not isinstance(own, Mapping):
            raise FiveBarError(f"'values' must be a list of dicts, but has {shown(own)} for run {number}")
    ready = []
    for number, (base, own) in enumerate(zip(bases, overrides)):
        try:
            ready.append(base.replace(own, **changes))
        except FiveBarError as error:
            raise FiveBarError(f"run {number}: {error}") from None
    return ready


def _run(task: tuple[int, Scene, tuple[str, ...], Reduce | None]) -> Outcome:
    """Runs one task, in this process or in a worker."""
    number, scene, outputs, reduce = task
    try:
        result = simulate.run_by(shared(), scene, outputs=outputs)
    except FiveBarError as error:
        return number, FiveBarError(f"run {number}: {error}"), None
    if (failure := simulate.failed(result)) is not None:
        return number, StepFailed(f"run {number}: {failure}", result), None
    return number, None, result if reduce is None else reduce(result)


class _Worker(SpawnProcess):
    """A process whose name is known while it imports the script."""

    def __init__(self, *given: Any, **named: Any):
        super().__init__(*given, **named)
        self.name = WORKER


class _Context(SpawnContext):
    Process = _Worker


def _in_processes(
    tasks: list[tuple[int, Scene, tuple[str, ...], Reduce | None]], count: int
) -> Generator[Outcome, None, None]:
    """Outcomes in order of completion. Processes are spawned: a fork would not copy the threads of other libraries."""
    own = multiprocessing.current_process()
    if own.name == WORKER and getattr(own, "_inheriting", False):
        # A worker imports a script that has no guard. The parent reports it; the worker's traceback would say less.
        sys.exit(1)
    # On Windows the library of a process that was killed may still be locked.
    with (
        tempfile.TemporaryDirectory(prefix="fivebar-", ignore_cleanup_errors=True) as folder,
        ProcessPoolExecutor(count, _Context(), initializer=_begin, initargs=(folder,)) as pool,
    ):
        try:
            for future in as_completed([pool.submit(_run, task) for task in tasks]):
                yield future.result()
        except BrokenProcessPool:
            raise FiveBarError(
                'a worker process ended before its run: a script must call run_many below `if __name__ == "__main__":`, and `reduce` must '
                "be a function of a module that the workers can import; processes=1 runs all in this process"
            ) from None
        finally:
            pool.shutdown(cancel_futures=True)


def _begin(folder: str) -> None:
    """Starts a worker. It extracts the unit into a folder of its parent, which removes it also after a worker that was killed."""
    tempfile.tempdir = folder


def _processors() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
