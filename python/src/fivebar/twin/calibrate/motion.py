"""Runs of the unit with the drive commands of a series: predicted encoder angles for given unknowns and a given start."""

from collections.abc import Sequence
from ctypes import c_double
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from fivebar.errors import UnitError
from fivebar.instance import Unit
from fivebar.library import Library
from fivebar.scene_file import OFFSETS
from fivebar.twin.calibrate.data import EARLIER, Samples
from fivebar.twin.calibrate.parameters import COMMANDS, CONSTANTS, DELAY, Parameter, Values, assemble
from fivebar.twin.recording import Array

METHOD: Final[Values] = {"solver.method": 6, "solver.maxWork": 2000}
"""Method automatic: it keeps the error near the tolerance, also with stiff drives."""

SHOWN: Final = ("theta[1]", "theta[2]", "omega[1]", "omega[2]")
LOST: Final = 1e3
"""Angle after the failure of a run, rad."""

SAME: Final = 1e-9
"""Two times that differ by less are the same, s."""

Between = Literal["rate", "linear", "hold"]
"""Commands between two samples: extrapolation of servo.theta with servo.omega, as in the twin; linear interpolation; or constant."""


@dataclass(frozen=True)
class Start:
    """Start of a series: angles, rad; rates, rad/s; assembly."""

    state: Array
    """(4): theta[1], theta[2], omega[1], omega[2]."""

    assembly: int


class Path:
    """Drive commands of a series, prepared for runs: at the times of samples and of lost samples (knots), and before them in the same series."""

    def __init__(self, samples: Samples, between: Between, library: Library, period: float):
        self.samples = samples
        self.time = samples.time - samples.time[0]
        self.inputs = library.blocks(samples.names)
        self.knots, self.rows = with_lost(self.time, period)
        earlier = samples.earlier
        self.begin = 0
        """Index of the first knot of `samples` among `all_knots`."""
        self.all_knots, times, given = self.knots, self.time, samples.commands
        if earlier is not None:
            times = np.concatenate([earlier.time - samples.time[0], self.time])
            given = np.concatenate([earlier.commands, samples.commands])
            self.all_knots, _ = with_lost(times, period)
            self.begin = len(self.all_knots) - len(self.knots)
        commands = at_knots(times, given, samples.names, self.all_knots)
        steps = np.diff(self.all_knots)
        slopes = np.zeros_like(commands[:-1])
        if between == "linear":
            slopes = np.diff(commands, axis=0) / steps[:, None]
        elif between == "rate":
            for j, name in enumerate(samples.names):
                rate = name.replace("theta", "omega")
                if name.startswith("servo.theta") and rate in samples.names:
                    slopes[:, j] = commands[:-1, samples.names.index(rate)]
        self.commands = commands
        """(all knots, m)."""
        self.turned = np.array([[float(name == f"servo.theta[{i}]") for name in samples.names] for i in (1, 2)])
        """(2, m): 1 if a command is the servo angle of a motor."""
        self.torques = np.array([[float(name == f"tau[{i}]") for name in samples.names] for i in (1, 2)])
        """(2, m): 1 if a command is the torque of a motor."""
        self.late = np.array([name.startswith("servo.") for name in samples.names], dtype=bool)
        """(m): whether a command is for a servo; commands for servos may act late."""
        self.slopes = slopes
        """(all knots - 1, m): rates of the commands after each knot but the last."""

    def true(self, offsets: Array, constants: Array, delay: float = 0.0) -> "ActingCommands":
        """Drive commands as they act, from the first to the last knot of the samples; servo commands act `delay` s late.

        Servo angles become true angles: a servo closes its loop on the encoder, which includes the offset. Torques are multiplied by `constants`.
        """
        factors = 1.0 + (constants - 1.0) @ self.torques
        commands = np.asarray((self.commands - offsets @ self.turned) * factors)
        slopes = np.asarray(self.slopes * factors)
        if delay == 0.0 or not self.late.any():
            return ActingCommands(self.knots, np.arange(len(self.knots)), commands[self.begin :], slopes[self.begin :])
        late = self.all_knots + delay
        inside = late[(late > self.knots[0]) & (late < self.knots[-1])]
        gaps = np.abs(inside - self.knots[_nearest(self.knots, inside)])
        times = np.sort(np.concatenate([self.knots, inside[gaps > SAME]]))
        parts = []
        for begins, columns in ((self.all_knots, ~self.late), (late, self.late)):
            # A command before the first one is the first one.
            last = np.searchsorted(begins, times + SAME, side="right") - 1
            known, place = last >= 0, np.clip(last, 0, len(slopes) - 1)
            rates = np.where(known[:, None], slopes[place], 0.0)
            since = np.where(known, times - begins[place], 0.0)
            parts.append(np.stack([commands[place] + rates * since[:, None], rates]) * columns)
        found, rates = parts[0] + parts[1]
        return ActingCommands(times, np.searchsorted(times, self.knots), found, rates[:-1])

    def first(self, offsets: Array, constants: Array) -> Values:
        """The first commands, by name, as they are given."""
        return dict(zip(self.samples.names, self.true(offsets, constants).commands[0].tolist(), strict=True))


@dataclass(frozen=True)
class ActingCommands:
    """Drive commands of a run."""

    times: Array
    """(n): times at which they change, the knots among them, s."""

    knots: NDArray[np.intp]
    """Indices of the knots among the times."""

    commands: Array
    """(n, m)."""

    slopes: Array
    """(n - 1, m): rates of the commands after each time but the last."""


def _nearest(knots: Array, times: Array) -> NDArray[np.intp]:
    """Index of the nearest knot of each time."""
    after = np.clip(np.searchsorted(knots, times), 1, len(knots) - 1)
    return np.asarray(after - (times - knots[after - 1] < knots[after] - times))


def with_lost(time: Array, period: float) -> tuple[Array, Array]:
    """Adds the times of lost samples; returns all times and the indices of the samples."""
    counts = np.maximum(1, np.round(np.diff(time) / period)).astype(int)
    rows = np.concatenate([[0], np.cumsum(counts)])
    return np.interp(np.arange(rows[-1] + 1), rows, time), rows


def at_knots(time: Array, commands: Array, names: tuple[str, ...], knots: Array) -> Array:
    """Commands at other times: cubic interpolation of servo angles with their rates, linear interpolation of all others."""
    if len(knots) == len(time):
        return commands
    found = (
        np.column_stack([np.interp(knots, time, column) for column in commands.T])
        if len(names)
        else np.empty((len(knots), 0))
    )
    for j, name in enumerate(names):
        rate = name.replace("theta", "omega")
        if name.startswith("servo.theta") and rate in names:
            cubic = CubicHermiteSpline(time, commands[:, j], commands[:, names.index(rate)])
            found[:, j], found[:, names.index(rate)] = cubic(knots), cubic(knots, 1)
    return found


class Player(Unit):
    """A unit that plays whole series. Commands and motion pass as arrays: one Python object per number takes half the time of a run."""

    def play(self, path: Path, given: ActingCommands, motion: Array) -> None:
        """Steps from the first time to the last one with the given commands; fills `motion`, (times, 4), from its second row on."""
        functions, component, times = self._functions, self._component, given.times.tolist()
        commands, slopes = (np.ascontiguousarray(each) for each in (given.commands, given.slopes))
        ramps = [any(rates) for rates in slopes.tolist()]
        shown, count = self.library.blocks(SHOWN)[0].references, len(SHOWN)
        rows = (c_double * count * len(motion)).from_buffer(motion.data)
        [block] = path.inputs or [None]
        if block is not None:
            inputs = len(block.references)
            numbers = (block.values * len(commands)).from_buffer(commands.data)
            rates = (block.values * len(slopes)).from_buffer(slopes.data)
        with self._lock:
            for k, (time, end) in enumerate(pairwise(times)):
                # fmi2OK and fmi2Warning are 0 and 1.
                failed = block is not None and (
                    functions.fmi2SetReal(component, block.references, inputs, numbers[k]) > 1
                    or ramps[k]
                    and functions.fmi2SetRealInputDerivatives(
                        component, block.references, inputs, block.orders, rates[k]
                    )
                    > 1
                )
                if (
                    failed
                    or functions.fmi2DoStep(component, time, end - time, 1) > 1
                    or functions.fmi2GetReal(component, shown, count, rows[k + 1]) > 1
                ):
                    raise UnitError(self._sentence(f"the unit failed at {time:g} s"))
                self._time = end


class Machine:
    """An instance of the unit for repeated runs."""

    def __init__(self, library: Library, scene: Values, sought: Sequence[Parameter]):
        self.library, self.scene, self.sought = library, scene | METHOD, sought
        self.unit = Player.of(library, "calibrate")
        self.runs = 0
        self.failure = ""
        """Reason of the last failure."""

    def tolerance(self, error: float) -> None:
        """Sets the error tolerance per step for the following runs, rad."""
        self.scene = self.scene | {"solver.errorTolerance": error}

    def run(self, path: Path, x: Array, start: Start) -> tuple[Array, int]:
        """Runs the motion; returns angles and rates, (knots, 4), and the assembly at the end."""
        self.runs += 1
        values = assemble(self.scene, self.library, self.sought, x.tolist())
        late = float(values.get(COMMANDS, self.library.variable(COMMANDS).start))
        values |= self.held(path.samples.names, self.offsets(x))
        # The unit knows no commands before its start, so they are delayed here.
        values[COMMANDS] = 0.0
        given = path.true(self.offsets(x), self.constants(x), min(late, EARLIER))
        out = np.full((len(given.times), 4), LOST)
        values |= {f"init.{name}": value for name, value in zip(SHOWN, start.state.tolist(), strict=True)}
        values["init.assembly"] = start.assembly
        unit = self.unit
        try:
            started = {name: value for name, value in values.items() if name not in OFFSETS}
            started |= dict(zip(path.samples.names, given.commands[0].tolist(), strict=True))
            unit.reset(float(given.times[0]), **started)
            out[0] = unit.numbers(SHOWN)
            unit.play(path, given, out)
            (assembly,) = unit.numbers(("mode.assembly",))
        except UnitError as error:
            self.failure = str(error)
            return out[given.knots], start.assembly
        return out[given.knots], int(assembly) if assembly in (1, 2) else start.assembly

    def seen(self, path: Path, motion: Array, x: Array) -> Array:
        """Encoder angles at the samples' times, rad, (n, 2), with delay and offsets."""
        angles: Array = late(path.knots, motion, self.added(x).get(DELAY, 0.0))[path.rows] + self.offsets(x)
        return angles

    def added(self, x: Array) -> dict[str, float]:
        """The fitted offsets, rad, and delay, s, of the encoders, and torque constants."""
        return {p.name: p.value(number)[0] for p, number in zip(self.sought, x.tolist(), strict=True) if not p.members}

    def offsets(self, x: Array) -> Array:
        """(2): encoder reading minus true angle, rad; from the scene unless fitted."""
        added = self.scene | self.added(x)
        return np.array([float(added.get(name, 0.0)) for name in OFFSETS])

    def held(self, given: Sequence[str], offsets: Array) -> Values:
        """Servo angles of the scene that a record does not give, as true angles for other mounting angles of the encoders.

        A servo closes its loop on the encoder, so that its reading stays as in the scene.
        """
        angles = {}
        for i, (name, offset) in enumerate(zip(OFFSETS, offsets.tolist(), strict=True), 1):
            servo = f"servo.theta[{i}]"
            if servo not in given:
                true = float(self.scene.get(servo, self.library.variable(servo).start))
                angles[servo] = true + float(self.scene.get(name, 0.0)) - offset
        return angles

    def constants(self, x: Array) -> Array:
        """(2): torque of each motor over the recorded one."""
        found = np.ones(2)
        for name, value in self.added(x).items():
            found[list(CONSTANTS.get(name, ()))] = value
        return found

    def close(self) -> None:
        """Frees the unit."""
        self.unit.close()

    def __getstate__(self) -> dict[str, Any]:
        """The state without the unit: a pickled fit makes no further runs."""
        return {name: value for name, value in vars(self).items() if name != "unit"}


def late(time: Array, motion: Array, delay: float) -> Array:
    """Angles `delay` s before each time, by cubic interpolation with rates; linear extrapolation beyond the first and last time."""
    if delay == 0.0:
        return motion[:, :2]
    at = time - delay
    inside = np.clip(at, time[0], time[-1])
    cubic = CubicHermiteSpline(time, motion[:, :2], motion[:, 2:])(inside)
    k = np.where(at < time[0], 0, len(time) - 1)
    return np.asarray(cubic + (at - inside)[:, None] * motion[k, 2:])
