"""Drives one run of the unit and records its variables at every communication point."""

import math
import time
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import TextIO

import numpy as np
from fmpy import fmi2

from fivebar.errors import FiveBarError, UnitError
from fivebar.instance import Unit
from fivebar.library import Library
from fivebar.progress import Line
from fivebar.scene import Scene, Variant, communication_points


@dataclass
class Run:
    """Results of one run: one row per communication point, the first at the start. Columns: the read variables, then the scene's signals.

    `items` has the names of the items of each enumeration, `descriptions` a sentence on each variable.
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
        """Whether the run ended early."""
        return self.failure is not None

    def part(self, rows: slice) -> "Run":
        """The run at some of its communication points, without times of calls."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        ends = len(columns["time"]) > 0 and columns["time"][-1] == self.time[-1]
        return replace(self, columns=columns, call_seconds=[], wall_seconds=0.0, failure=self.failure if ends else None)


class StartRefused(FiveBarError):
    """The FMU refused the start values; the text is its message."""


class _Recorder:
    """Reads variables at communication points into one table for each type."""

    def __init__(self, unit: Unit, names: tuple[str, ...], rows: int):
        self.unit, self.names, self.rows = unit, names, 0
        self.blocks = unit.library.blocks(names)
        self.tables = [
            np.empty((rows, len(block.places)), dtype=np.float64 if block.getter == "fmi2GetReal" else np.int64)
            for block in self.blocks
        ]

    def record(self) -> None:
        for block, table in zip(self.blocks, self.tables, strict=True):
            table[self.rows] = self.unit.read(block)
        self.rows += 1

    def columns(self, points: np.ndarray) -> dict[str, np.ndarray]:
        columns = {"time": points[: self.rows]}
        for block, table in zip(self.blocks, self.tables, strict=True):
            columns |= {self.names[place]: table[: self.rows, i] for i, place in enumerate(block.places)}
        return columns


class Progress(Line):
    """A line with simulated time, speed and remaining time: about 5 times a second on a terminal, every 10 % elsewhere."""

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
    """The scene's signals: each is set at a communication point and constant during the next step."""

    def __init__(self, unit: Unit, scene: Scene):
        self.unit = unit
        self.block = unit.library.reals(tuple(scene.signals))
        self.rows = np.column_stack(list(scene.signals.values())).tolist() if scene.signals else []

    def hold(self, row: int) -> None:
        if self.block is not None:
            self.unit.write(self.block, self.rows[row])


def drive(
    library: Library,
    scene: Scene,
    variant: Variant,
    progress: Progress | None = None,
    outputs: Collection[str] | None = None,
) -> Run:
    """Runs `variant` of `scene`. A failed step ends the run without an exception.

    Only the variables `outputs` are read, because reading all takes several times as long as a step.
    """
    begin = time.perf_counter()
    known = library.known
    names = tuple(name for name in known.computed if outputs is None or name in outputs)
    points = communication_points(scene.stop_time, scene.step_size)
    try:
        with Unit.of(library, scene.name) as unit:
            try:
                unit.reset(**variant.values | {name: float(course[0]) for name, course in scene.signals.items()})
            except UnitError as refusal:
                raise StartRefused(str(refusal)) from None
            recorder = _Recorder(unit, names, len(points))
            recorder.record()
            settings = tuple(v.name for v in known.values() if v.causality == "parameter")
            numbers = unit.numbers(settings)
            call_seconds, failure = _step(unit, points, _Signals(unit, scene), recorder, progress)
            warnings = [message.text for message in unit.log if message.status == fmi2.fmi2Warning]
    finally:
        if progress is not None:
            progress.finish()
    return Run(
        label=variant.label,
        stop_time=scene.stop_time,
        step_size=scene.step_size,
        units={"time": "s"} | {v.name: v.unit for v in known.values()},
        columns=recorder.columns(points) | {name: column[: recorder.rows] for name, column in scene.signals.items()},
        parameters=dict(zip(settings, numbers, strict=True)),
        items={
            name: {number: item for item, number in known[name].items.items()}
            for name in names
            if known[name].type == "Enumeration"
        },
        call_seconds=call_seconds,
        wall_seconds=time.perf_counter() - begin,
        failure=failure,
        warnings=warnings,
        descriptions={"time": "Time since the start"} | {v.name: v.description for v in known.values()},
    )


def _step(
    unit: Unit, points: np.ndarray, signals: _Signals, recorder: _Recorder, progress: Progress | None
) -> tuple[list[float], str | None]:
    """Steps through `points`; returns the seconds of each step, and the unit's message if a call failed."""
    clock = time.perf_counter
    seconds: list[float] = []
    for row, then in enumerate(points[1:].tolist()):
        try:
            signals.hold(row)
            before = clock()
            unit.step_to(then)
            seconds.append(clock() - before)
            recorder.record()
        except UnitError as error:
            return seconds, str(error)
        if progress is not None:
            progress.update(then)
    return seconds, None
