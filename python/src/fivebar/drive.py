"""Drives one run of the FMU through FMPy and records what it computes at every communication point."""

import math
import time
from collections.abc import Collection
from ctypes import c_double, c_int
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TextIO

import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription, ScalarVariable

from fivebar.errors import FiveBarError
from fivebar.progress import Line
from fivebar.scene import Scene, Variant, communication_points
from fivebar.slave import Log, computed, get_values, instantiate, set_values
from fivebar.variables import unit


@dataclass
class Run:
    """Results of one run: one row per communication point, the first at the start; the variables that were read, then the scene's signals.

    `items` has the names of the values of each variable that is an enumeration, `descriptions` a sentence on each variable.
    """

    label: str
    stop_time: float
    step_size: float
    units: dict[str, str]
    columns: dict[str, np.ndarray]
    parameters: dict[str, float | int | bool]
    items: dict[str, dict[int, str]] = field(default_factory=dict)
    call_seconds: list[float] = field(default_factory=list)
    wall_seconds: float = 0.0
    failure: str | None = None
    warnings: list[str] | None = None
    descriptions: dict[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    @property
    def time(self) -> np.ndarray:
        """Communication points, s."""
        return self.columns["time"]

    @property
    def step_seconds(self) -> float:
        """Seconds spent in fmi2DoStep."""
        return sum(self.call_seconds)

    @property
    def failed(self) -> bool:
        """Whether the run ended before its time."""
        return self.failure is not None

    def part(self, rows: slice) -> "Run":
        """The run at some of its communication points. Times of calls are those of a whole run, and are left out."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        ends = len(columns["time"]) > 0 and columns["time"][-1] == self.time[-1]
        return replace(self, columns=columns, call_seconds=[], wall_seconds=0.0, failure=self.failure if ends else None)


class StartRefused(FiveBarError):
    """The FMU refused the start values; the text is its sentence."""


class _Recorder:
    """Reads variables at once into two tables, one of numbers and one of integers."""

    def __init__(self, slave: fmi2.FMU2Slave, variables: list[ScalarVariable], rows: int):
        self.slave = slave
        self.rows = 0
        self.reals = [v for v in variables if v.type == "Real"]
        self.integers = [v for v in variables if v.type in ("Integer", "Enumeration")]
        self.real_table = np.empty((rows, len(self.reals)))
        self.integer_table = np.empty((rows, len(self.integers)), dtype=np.int64)
        self.real_references = (fmi2.fmi2ValueReference * len(self.reals))(*(v.valueReference for v in self.reals))
        self.integer_references = (fmi2.fmi2ValueReference * len(self.integers))(
            *(v.valueReference for v in self.integers)
        )
        self.real_values = (c_double * len(self.reals))()
        self.integer_values = (c_int * len(self.integers))()

    def record(self) -> None:
        slave, reals, integers = self.slave, len(self.reals), len(self.integers)
        slave.fmi2GetReal(slave.component, self.real_references, reals, self.real_values)
        slave.fmi2GetInteger(slave.component, self.integer_references, integers, self.integer_values)
        self.real_table[self.rows] = self.real_values
        self.integer_table[self.rows] = self.integer_values
        self.rows += 1

    def columns(self, points: np.ndarray) -> dict[str, np.ndarray]:
        n = self.rows
        columns = {"time": points[:n]}
        columns |= {v.name: self.real_table[:n, i] for i, v in enumerate(self.reals)}
        columns |= {v.name: self.integer_table[:n, i] for i, v in enumerate(self.integers)}
        return columns


class Progress(Line):
    """A line with simulated time, speed and time to go: about 5 times a second on a terminal, every 10 % elsewhere."""

    def __init__(self, label: str, stop_time: float, stream: TextIO | None = None):
        super().__init__(stream)
        self.label, self.stop_time = label, stop_time
        self.begin = self.shown = time.perf_counter()
        self.next_share = 0.1

    def update(self, simulated: float) -> None:
        """Shows the line if it is due."""
        now = time.perf_counter()
        share = simulated / self.stop_time
        if self.terminal:
            if now - self.shown < 0.2:
                return
        elif share < self.next_share - 1e-9:
            return
        self.shown = now
        self.next_share = math.floor(share * 10 + 1e-9) / 10 + 0.1
        elapsed = now - self.begin
        speed = simulated / elapsed if elapsed > 0 else 0.0
        to_go = (self.stop_time - simulated) / speed if speed > 0 else 0.0
        self.show(
            f"{self.label}: {simulated:7.2f} s of {self.stop_time:g} s  {share:4.0%}  {speed:6.1f} x real time  {to_go:4.0f} s to go"
        )


class _Signals:
    """The scene's signals: each is set at the communication point and held over the step that follows."""

    def __init__(self, slave: fmi2.FMU2Slave, model: ModelDescription, scene: Scene):
        self.slave = slave
        references = {v.name: v.valueReference for v in model.modelVariables}
        self.references = [references[name] for name in scene.signals]
        self.rows = np.column_stack(list(scene.signals.values())).tolist() if scene.signals else []

    def hold(self, row: int) -> None:
        if self.rows:
            self.slave.setReal(self.references, self.rows[row])


def drive(
    model: ModelDescription,
    directory: str,
    scene: Scene,
    variant: Variant,
    progress: Progress | None = None,
    outputs: Collection[str] | None = None,
) -> Run:
    """Runs `variant` of `scene` with the FMU extracted to `directory`. A step that fails ends the run, not the program.

    `outputs` are names of variables; only they are read, for reading all that the unit computes takes several times as long as a step.
    """
    begin = time.perf_counter()
    variables = [v for v in computed(model) if outputs is None or v.name in outputs]
    points = communication_points(scene.stop_time, scene.step_size)
    log = Log()
    slave = instantiate(model, directory, log, name=scene.name)
    try:
        signals = _Signals(slave, model, scene)
        _initialise(slave, model, scene, variant, signals, log)
        recorder = _Recorder(slave, variables, len(points))
        recorder.record()
        parameters = get_values(slave, model, [v.name for v in model.modelVariables if v.causality == "parameter"])
        call_seconds, failure = _step(slave, points, signals, recorder, progress, log)
        if failure is None:
            slave.terminate()
    finally:
        slave.freeInstance()
        if progress is not None:
            progress.finish()
    return Run(
        label=variant.label,
        stop_time=scene.stop_time,
        step_size=scene.step_size,
        units={"time": "s"} | {v.name: unit(v) for v in model.modelVariables},
        columns=recorder.columns(points) | {name: column[: recorder.rows] for name, column in scene.signals.items()},
        parameters=parameters,
        items={
            v.name: {int(i.value): i.name for i in v.declaredType.items} for v in variables if v.type == "Enumeration"
        },
        call_seconds=call_seconds,
        wall_seconds=time.perf_counter() - begin,
        failure=failure,
        warnings=log.warnings(),
        descriptions={"time": "Time since the start"} | {v.name: v.description or "" for v in model.modelVariables},
    )


def _initialise(
    slave: fmi2.FMU2Slave, model: ModelDescription, scene: Scene, variant: Variant, signals: _Signals, log: Log
) -> None:
    try:
        set_values(slave, model, variant.values)
        signals.hold(0)
        slave.setupExperiment(startTime=0.0, stopTime=scene.stop_time)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
    except FMICallException as error:
        raise StartRefused(log.last() or str(error)) from None


def _step(
    slave: fmi2.FMU2Slave,
    points: np.ndarray,
    signals: _Signals,
    recorder: _Recorder,
    progress: Progress | None,
    log: Log,
) -> tuple[list[float], str | None]:
    """Steps through `points`; seconds that each fmi2DoStep took, and the FMU's sentence if a call failed."""
    clock = time.perf_counter
    seconds: list[float] = []
    for row, (now, then) in enumerate(pairwise(points.tolist())):
        try:
            signals.hold(row)
            before = clock()
            slave.doStep(now, then - now)
            seconds.append(clock() - before)
            recorder.record()
        except FMICallException as error:
            return seconds, log.last() or str(error)
        if progress is not None:
            progress.update(then)
    return seconds, None
