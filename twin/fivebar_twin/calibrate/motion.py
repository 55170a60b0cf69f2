"""Runs of the unit along what the drives were told: the motion that an encoder would have seen, for given unknowns and a given start."""

from collections.abc import Sequence
from ctypes import c_double
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException

from fivebar_twin.calibrate.data import Array, Samples
from fivebar_twin.calibrate.parameters import DELAY, OFFSETS, Parameter, Values, assemble
from fivebar_twin.unit import Library, Unit, UnitError

METHOD: Final[Values] = {"solver.method": 4, "solver.adaptive": True}
"""dop853: what it shows between its steps is smooth, and its error is where one wants it."""

SHOWN: Final = ("theta[1]", "theta[2]", "omega[1]", "omega[2]")
LOST: Final = 1e3
"""rad: what a run shows that could not go on."""

Between = Literal["rate", "linear", "hold"]
"""What drives do between two samples: servo.theta goes on at servo.omega, as the twin has it; straight lines; or all is held."""


@dataclass(frozen=True)
class Start:
    """Where a series begins: angles, rad; rates, rad/s; the side of the tip."""

    state: Array
    """(4): theta[1], theta[2], omega[1], omega[2]."""

    assembly: int


class Path:
    """What the drives are told along a series, ready for calls."""

    def __init__(self, samples: Samples, between: Between, library: Library, period: float):
        self.samples = samples
        self.time = samples.time - samples.time[0]
        self.references = (fmi2.fmi2ValueReference * len(samples.names))(*(library.variable(name).valueReference for name in samples.names))
        steps = np.diff(self.time)
        slopes = np.zeros_like(samples.commands[:-1])
        lines = np.diff(samples.commands, axis=0) / steps[:, None]
        if between == "linear":
            slopes = lines
        elif between == "rate":
            for j, name in enumerate(samples.names):
                rate = name.replace("theta", "omega")
                if name.startswith("servo.theta") and rate in samples.names:
                    slopes[:, j] = samples.commands[:-1, samples.names.index(rate)]
            # Over a lost sample the next one knows better.
            lost = steps > 1.5 * period
            slopes[lost] = lines[lost]
        self.values = [(c_double * len(row))(*row) for row in samples.commands.tolist()]
        self.slopes = [(c_double * len(row))(*row) if any(row) else None for row in slopes.tolist()]
        self.orders = (fmi2.fmi2Integer * len(samples.names))(*([1] * len(samples.names)))


class Machine:
    """An instance of the unit that is started again and again."""

    def __init__(self, library: Library, scene: Values, sought: Sequence[Parameter]):
        self.library, self.scene, self.sought = library, scene | METHOD, sought
        self.unit = Unit(library, "calibrate")
        self.shown = (fmi2.fmi2ValueReference * 4)(*(library.variable(name).valueReference for name in SHOWN))
        self.runs = 0
        self.failure = ""
        """Why the last run that failed did."""

    def tolerance(self, error: float) -> None:
        """Error per step of the runs that follow, rad."""
        self.scene = self.scene | {"solver.errorTolerance": error}

    def run(self, path: Path, x: Array, start: Start) -> tuple[Array, int]:
        """Angles and rates, (n, 4), at the samples' times; and on which side the tip is in the end."""
        self.runs += 1
        out = np.full((len(path.samples), 4), LOST)
        values = assemble(self.scene, self.library, self.sought, x.tolist())
        values |= {f"init.{name}": value for name, value in zip(SHOWN, start.state.tolist(), strict=True)}
        values["init.assembly"] = start.assembly
        unit, slave = self.unit, self.unit.slave
        buffer = (c_double * 4)()
        count = len(path.references)
        times = path.time.tolist()
        try:
            if count:
                values |= dict(zip(path.samples.names, path.samples.commands[0].tolist(), strict=True))
            unit.start(values)
            for k, time in enumerate(times):
                slave.fmi2GetReal(slave.component, self.shown, 4, buffer)
                out[k] = buffer
                if k + 1 < len(times):
                    if count:
                        slave.fmi2SetReal(slave.component, path.references, count, path.values[k])
                        if path.slopes[k] is not None:
                            slave.fmi2SetRealInputDerivatives(slave.component, path.references, count, path.orders, path.slopes[k])
                    slave.fmi2DoStep(slave.component, time, times[k + 1] - time, 1)
            assembly = int(unit.get(["mode.assembly"])["mode.assembly"])
        except (FMICallException, UnitError) as error:
            self.failure = str(error) if isinstance(error, UnitError) else (unit.log[-1] if unit.log else str(error))
            return out, start.assembly
        return out, assembly if assembly in (1, 2) else start.assembly

    def seen(self, path: Path, motion: Array, x: Array) -> Array:
        """What encoders show of that motion, (n, 2): late, and with their offsets."""
        added = {p.name: p.value(number)[0] for p, number in zip(self.sought, x.tolist(), strict=True) if not p.members}
        angles = late(path.time, motion, added.get(DELAY, 0.0))
        return angles + np.array([added.get(name, 0.0) for name in OFFSETS])

    def close(self) -> None:
        """Frees the unit."""
        self.unit.close()


def late(time: Array, motion: Array, delay: float) -> Array:
    """Angles `delay` s before each time, by cubics through angles and rates; before the first time its rate is gone on with."""
    if delay == 0.0:
        return motion[:, :2]
    at = time - delay
    k = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    h = (time[k + 1] - time[k])[:, None]
    u = np.clip((at - time[k])[:, None] / h, 0.0, 1.0)
    q, v = motion[:, :2], motion[:, 2:]
    cubic = (
        (1 + 2 * u) * (1 - u) ** 2 * q[k]
        + u * (1 - u) ** 2 * h * v[k]
        + u**2 * (3 - 2 * u) * q[k + 1]
        + u**2 * (u - 1) * h * v[k + 1]
    )
    before = np.minimum(at - time[0], 0.0)[:, None]
    after = np.maximum(at - time[-1], 0.0)[:, None]
    return cubic + before * v[0] + after * v[-1]
