"""Scenes in tip coordinates: a start by tip position, and tip trajectories for the servos.

Additional keys of a scene's file:

- `tip.x`, `tip.y`: initial tip position, m. `init.theta[1..2]` and `init.assembly` follow from it.
- `mode.working`: bends of the left and the right leg. The default is ["minus", "plus"], or the mode of the initial angles if
  these are given.
- `mode.assembly`: refused if the tip cannot be in it. It matters only at a direct singularity, where both are possible.
- signals `tip.x`, `tip.y`: `servo.theta[1..2]` and `servo.omega[1..2]` follow at every communication point, by inverse
  kinematics of the scene's machine. A coordinate without a signal keeps its initial value. If no initial position is given, it
  is the value of the signals at 0 s.

Initial angles are at the whole turn nearest to the middle of the motor's stops, or without stops to the rest angle of its
spring, or without spring to 0. Signals continue from there.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fivebar.errors import FiveBarError
from fivebar.kinematics import GEOMETRY, SIGN, Machine, Sign, Working, sines
from fivebar.signals import TIP, Signal
from fivebar.variables import Value, Values, Variables, shown

Floats = NDArray[np.float64]

WORKING, ASSEMBLY = MODE = ("mode.working", "mode.assembly")

KEYS = (*TIP, *MODE)
"""Keys of a file that are not settable variables."""

START = ("init.theta[1]", "init.theta[2]", "init.assembly")
"""Variables that follow from the initial tip position."""

SERVO_ANGLES, SERVO_RATES = ("servo.theta[1]", "servo.theta[2]"), ("servo.omega[1]", "servo.omega[2]")
"""Variables that follow from the tip's signals."""

OUTWARD: Working = ("minus", "plus")


@dataclass(frozen=True)
class Tip:
    """The part of a scene in tip coordinates."""

    start: Mapping[str, float]
    """Given initial coordinates, m, by key."""

    working: Working | None
    assembly: Sign | None
    signals: Mapping[str, Signal]
    """Signals of the tip by key."""

    @property
    def follows(self) -> tuple[str, ...]:
        """Inputs that follow from the signals."""
        return (*SERVO_ANGLES, *SERVO_RATES) if self.signals else ()

    def content(self) -> dict[str, Any]:
        """The keys in a file, without signals."""
        working = {} if self.working is None else {WORKING: list(self.working)}
        return {**self.start, **working, **({} if self.assembly is None else {ASSEMBLY: self.assembly})}

    @property
    def place(self) -> tuple[float, ...]:
        """The initial coordinates, m."""
        return tuple(self.start[name] if name in self.start else self.signals[name].at(0.0) for name in TIP)

    def without_signals(self) -> "Tip":
        """The same start, given by coordinates."""
        return replace(self, start=dict(zip(TIP, self.place)), signals={})

    def without_start(self, given: str) -> "Tip | None":
        """The part for a file that has initial angles or the assembly; `given` is the name of one of them. None if nothing is left."""
        if not self.start:
            return self
        if missing := [name for name in TIP if self.signals and name not in self.signals]:
            raise FiveBarError(
                f"'{given}' is given, but '{missing[0]}' at the start is the tip's reference too: a file has one of them only"
            )
        return replace(self, start={}) if self.signals else None

    def placed(self, values: Values, unit: Mapping[str, Value]) -> Values:
        """The values of a run with initial angles from the tip position, unless given; `unit` has the unit's start values."""
        if any(name in values for name in START[:2]):
            return values
        place = self.place
        try:
            posture = _machine(values, unit).inverse(place, self.working or OUTWARD)
        except ValueError as error:
            raise FiveBarError(f"the start: {error}") from None
        sine = float(sines(posture.theta)[0])
        assembly = self.assembly or "plus"
        if self.assembly is None and abs(sine) > 1e-12:
            assembly = "plus" if sine > 0 else "minus"
        if sine * SIGN[assembly] < -1e-12:
            left, right = self.working or OUTWARD
            raise FiveBarError(
                f"'{ASSEMBLY}' is {assembly}, but with 'tip.x' = {place[0]:g} m and 'tip.y' = {place[1]:g} m in working mode {left}, {right} the tip "
                f"is in assembly {'minus' if assembly == 'plus' else 'plus'}"
            )
        motors = [
            _nearest_turn(float(angle), _middle(values, unit, leg)) for leg, angle in enumerate(posture.motors, 1)
        ]
        return values | dict(zip(START, motors)) | ({} if assembly == "plus" else {START[2]: 2})

    def commands(self, values: Values, unit: Mapping[str, Value], points: Floats) -> dict[str, Floats]:
        """Servo references at communication points, s; `values` has the machine and its start."""
        if not self.signals:
            return {}
        machine = _machine(values, unit)
        begin = np.array([float(values.get(name, unit[name])) for name in START[:2]])
        tip, velocity = (
            np.stack([self.coordinate(name, points, rate) for name in TIP], axis=-1) for rate in (False, True)
        )
        mode = self.working or self._of_start(machine, begin, values)
        try:
            theta = machine.inverse(tip, mode).theta
            omega = machine.motor_rates(theta, velocity)
        except ValueError:
            raise FiveBarError(_first_mistake(machine, mode, points, tip, velocity)) from None
        crossed = np.flatnonzero(np.diff(sines(theta)[:, 0] > 0))
        if len(crossed):
            row = int(crossed[0])
            raise FiveBarError(
                f"signals 'tip.x', 'tip.y': between {points[row]:g} and {points[row + 1]:g} s the tip crosses a direct singularity of working mode "
                f"{mode[0]}, {mode[1]} at ({tip[row, 0]:.6g}, {tip[row, 1]:.6g}) m, where the motors do not determine its motion"
            )
        angles = np.unwrap(theta[:, [0, 3]], axis=0)
        angles += [_nearest_turn(float(angle), middle) - float(angle) for angle, middle in zip(angles[0], begin)]
        return dict(zip(SERVO_ANGLES, angles.T)) | dict(zip(SERVO_RATES, omega.T))

    def coordinate(self, name: str, points: Floats, rate: bool) -> Floats:
        """A coordinate of the tip's reference at communication points, m, or its rate, m/s."""
        if name not in self.signals:
            return np.full(len(points), 0.0 if rate else self.start[name])
        signal = replace(self.signals[name], rate=True) if rate else self.signals[name]
        return np.array([signal.at(time) for time in points.tolist()])

    def _of_start(self, machine: Machine, motors: Floats, values: Values) -> Working:
        """The working mode of the initial angles."""
        try:
            left, right = machine.forward(motors, "minus" if values.get(START[2]) == 2 else "plus").working.tolist()
        except ValueError:
            return OUTWARD
        return left, right


def read(content: Mapping[str, Any], values: Values, signals: list[Signal], variables: Variables) -> Tip | None:
    """The part of a file's content in tip coordinates, or None; `values` and `signals` are all values and signals of the file."""
    start = {name: float(variables[name].value(content[name])) for name in TIP if name in content}
    moved = {signal.variable.name: signal for signal in signals if signal.variable.name in TIP}
    if not start and not moved:
        if mode := [name for name in MODE if name in content]:
            raise FiveBarError(f"'{mode[0]}' has no effect without 'tip.x' and 'tip.y'")
        return None
    for name in TIP:
        if name not in start and name not in moved:
            raise FiveBarError(f"'{name}' must be given as well, as the tip's place at the start or as a signal")
    for follows, given in ((START, start), ((*SERVO_ANGLES, *SERVO_RATES), moved)):
        others = {*values, *(signal.variable.name for signal in signals)} & set(follows)
        if given and others:
            raise FiveBarError(
                f"'{min(others)}' follows from {'signals ' if given is moved else ''}'tip.x' and 'tip.y', and cannot be given as well"
            )
    return Tip(start, _working(content), _assembly(content), moved)


def _working(content: Mapping[str, Any]) -> Working | None:
    given = content.get(WORKING)
    if given is None and WORKING not in content:
        return None
    if not (
        isinstance(given, list) and len(given) == 2 and all(isinstance(bend, str) and bend in SIGN for bend in given)
    ):
        raise FiveBarError(
            f'\'{WORKING}\' must be the bends of the left and the right leg, such as ["minus", "plus"], not {shown(given)}'
        )
    return given[0], given[1]


def _assembly(content: Mapping[str, Any]) -> Sign | None:
    given = content.get(ASSEMBLY)
    if given is None and ASSEMBLY not in content:
        return None
    if not (isinstance(given, str) and given in SIGN):
        raise FiveBarError(f"'{ASSEMBLY}' must be one of plus, minus, not {shown(given)}")
    return "plus" if given == "plus" else "minus"


def _machine(values: Values, unit: Mapping[str, Value]) -> Machine:
    return Machine.from_values({name: float(values.get(name, unit[name])) for name in GEOMETRY})


def _middle(values: Values, unit: Mapping[str, Value], leg: int) -> float:
    """The angle, rad, to which the initial angle of a motor should be nearest."""
    stops, rest = (f"stop.lower[{leg}]", f"stop.upper[{leg}]"), (f"spring.theta0[{leg}]",)
    for switch, names in (("stop.enabled", stops), ("spring.enabled", rest)):
        if values.get(switch, unit[switch]):
            return sum(float(values.get(name, unit[name])) for name in names) / len(names)
    return 0.0


def _nearest_turn(angle: float, middle: float) -> float:
    return angle + 2 * np.pi * round((middle - angle) / (2 * np.pi))


def _first_mistake(machine: Machine, mode: Working, points: Floats, tip: Floats, velocity: Floats) -> str:
    """Time and reason of the first point that cannot be reached, or not with this velocity."""
    for time, place, rate in zip(points.tolist(), tip, velocity):
        try:
            machine.motor_rates(machine.inverse(place, mode).theta, rate)
        except ValueError as error:
            return f"signals 'tip.x', 'tip.y' at {time:g} s: {error}"
    raise AssertionError("no single place was refused")
