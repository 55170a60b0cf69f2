"""Runs of the unit with the drive commands of a series: predicted encoder angles for given unknowns and a given start."""

from collections.abc import Sequence
from ctypes import c_double
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, Literal

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from fivebar.errors import UnitError
from fivebar.instance import Unit
from fivebar.library import Library
from fivebar.scene_file import OFFSETS
from fivebar.twin.calibrate.data import Samples
from fivebar.twin.calibrate.parameters import CONSTANTS, DELAY, Parameter, Values, assemble
from fivebar.twin.recording import Array

METHOD: Final[Values] = {"solver.method": 6, "solver.maxWork": 2000}
"""Method automatic: it keeps the error near the tolerance, also with stiff drives."""

SHOWN: Final = ("theta[1]", "theta[2]", "omega[1]", "omega[2]")
LOST: Final = 1e3
"""Angle after the failure of a run, rad."""

Between = Literal["rate", "linear", "hold"]
"""Commands between two samples: extrapolation of servo.theta with servo.omega, as in the twin; linear interpolation; or constant."""


@dataclass(frozen=True)
class Start:
    """Start of a series: angles, rad; rates, rad/s; assembly."""

    state: Array
    """(4): theta[1], theta[2], omega[1], omega[2]."""

    assembly: int


class Path:
    """Drive commands of a series, prepared for runs: at the times of samples and of lost samples (knots)."""

    def __init__(self, samples: Samples, between: Between, library: Library, period: float):
        self.samples = samples
        self.time = samples.time - samples.time[0]
        self.inputs = library.blocks(samples.names)
        self.knots, self.rows = with_lost(self.time, period)
        commands = at_knots(self.time, samples.commands, samples.names, self.knots)
        steps = np.diff(self.knots)
        slopes = np.zeros_like(commands[:-1])
        if between == "linear":
            slopes = np.diff(commands, axis=0) / steps[:, None]
        elif between == "rate":
            for j, name in enumerate(samples.names):
                rate = name.replace("theta", "omega")
                if name.startswith("servo.theta") and rate in samples.names:
                    slopes[:, j] = commands[:-1, samples.names.index(rate)]
        self.commands = commands
        self.turned = np.array([[float(name == f"servo.theta[{i}]") for name in samples.names] for i in (1, 2)])
        """(2, m): 1 if a command is the servo angle of a motor."""
        self.torques = np.array([[float(name == f"tau[{i}]") for name in samples.names] for i in (1, 2)])
        """(2, m): 1 if a command is the torque of a motor."""
        self.slopes = slopes
        """(knots - 1, m): rates of the commands after each knot but the last."""
        self.ramps = [any(rates) for rates in slopes.tolist()]

    def true(self, offsets: Array, constants: Array) -> tuple[Array, Array]:
        """Drive commands at the knots, and their rates.

        Servo angles become true angles: a servo closes its loop on the encoder, which includes the offset. Torques are multiplied by their constants.
        """
        factors = 1.0 + (constants - 1.0) @ self.torques
        return np.asarray((self.commands - offsets @ self.turned) * factors), np.asarray(self.slopes * factors)

    def first(self, offsets: Array, constants: Array) -> Values:
        """The first commands, by name."""
        return dict(zip(self.samples.names, self.true(offsets, constants)[0][0].tolist(), strict=True))


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

    def play(self, path: Path, commands: Array, slopes: Array, motion: Array) -> None:
        """Steps from the first knot to the last one with commands, (knots, m), and their rates; fills `motion`, (knots, 4), from its second row on."""
        functions, component, times = self._functions, self._component, path.knots.tolist()
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
                    or path.ramps[k]
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
        out = np.full((len(path.knots), 4), LOST)
        values = assemble(self.scene, self.library, self.sought, x.tolist())
        values |= {f"init.{name}": value for name, value in zip(SHOWN, start.state.tolist(), strict=True)}
        values["init.assembly"] = start.assembly
        unit, offsets, constants = self.unit, self.offsets(x), self.constants(x)
        try:
            started = {name: value for name, value in values.items() if name not in OFFSETS} | path.first(
                offsets, constants
            )
            unit.reset(float(path.knots[0]), **started)
            out[0] = unit.numbers(SHOWN)
            unit.play(path, *path.true(offsets, constants), out)
            (assembly,) = unit.numbers(("mode.assembly",))
        except UnitError as error:
            self.failure = str(error)
            return out, start.assembly
        return out, int(assembly) if assembly in (1, 2) else start.assembly

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
        """Without the unit: a pickled fit has all that was found, and makes no further runs."""
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
