"""Unknowns of a calibration: parameters of the unit by name, also several in one proportion, offsets and delay of encoders, torque constants.

`link[1,4].mass` is one unknown: a common factor on both masses. Each unknown is a scaled number `x`; at the scene's value it is 1 (for a
factor) or 0 (for an addition). A link's inertia changes in proportion to its mass. With its length, the centre of mass changes in
proportion and the inertia with the square, unless the centre of mass is an unknown, too: then the same body has its joint elsewhere.
Breakaway friction changes with Coulomb friction.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fivebar.library import Library
from fivebar.scene_file import OFFSETS
from fivebar.twin.errors import TwinError
from fivebar.twin.recording import Array

Values = dict[str, float | int | bool]

DELAY: Final = "encoder.delay"
COMMANDS: Final = "servo.delay"
"""Delay of the commands of the servos, a parameter of the unit."""

MUCH_DELAY: Final = 0.02
"""Typical upper size of an unknown delay, s."""

ADDITIONS: Final = {**dict.fromkeys(OFFSETS, ("rad", 0.2)), DELAY: ("s", MUCH_DELAY)}
"""Unknowns of the measurement, which are not parameters of the unit: SI unit, and typical upper size."""

CONSTANT: Final = "torque.constant"
CONSTANTS: Final = {CONSTANT: (0, 1), **{f"{CONSTANT}[{i + 1}]": (i,) for i in (0, 1)}}
"""Torque of a motor over the recorded `tau`, with the indices of the motors: N.m/A if the record has currents."""

MUCH_ANGLE: Final = 0.2
"""Typical upper size of an unknown angle, rad."""

UPRIGHT: Final = 0.05
"""rad: a machine that stands at least this upright starts tilted by half of `MUCH_ANGLE`, so that derivatives against its tilt are not 0."""

SWITCHES: Final = {
    "payload": "payload.enabled",
    "viscous": "viscous.enabled",
    "friction": "friction.enabled",
    "spring": "spring.enabled",
    "rotor": "rotor.enabled",
}
"""Switch that a parameter needs, by the first word of its name."""

USUAL: Final = (
    "payload.mass",
    *(f"link[{i}].mass" for i in (1, 2, 3, 4)),
    "link[1,4].length",
    "link[2,3].length",
    "base.distance",
    "link[1,4].com",
    "link[2,3].com",
    "viscous.b[1,5]",
    "viscous.b[2,3,4]",
    "friction.coulomb[1,5]",
    "gravity.direction",
    *OFFSETS,
)
"""Default unknowns."""

BRACKETS: Final = re.compile(r"\[([\d,]+)\]")


@dataclass(frozen=True)
class Parameter:
    """An unknown of a calibration."""

    name: str
    unit: str
    members: tuple[str, ...]
    """Variables of the unit; empty for offsets and delay of encoders, and for torque constants."""

    base: tuple[float, ...]
    """Their values at x = 1 (factor) or x = 0 (addition)."""

    factor: bool
    size: float
    """Change per unit of x for an addition; 1 for a factor."""

    lowest: float
    """Lower bound of x."""

    start: float
    """Start of the fit, x."""

    def value(self, x: float) -> tuple[float, ...]:
        """Value of each member; offsets and delay of encoders have one value."""
        return tuple(base * x if self.factor else base + self.size * x for base in self.base)

    def bar(self, sigma: float) -> tuple[float, ...]:
        """Converts a standard deviation of x to standard deviations of the members."""
        return tuple(abs(base) * sigma if self.factor else self.size * sigma for base in self.base)

    @property
    def origin(self) -> float:
        """x at the scene's value."""
        return 1.0 if self.factor else 0.0


@dataclass(frozen=True)
class Asked:
    """Words for error messages about requested parameter names."""

    done: str
    """A participle: `sought`."""

    examples: tuple[str, ...]
    """Examples of allowed names; offsets and delay of encoders and torque constants are only allowed if they are among them."""


SOUGHT: Final = Asked("sought", (*USUAL, DELAY, COMMANDS, CONSTANT))


def parameters(names: Sequence[str], library: Library, scene: Values, asked: Asked = SOUGHT) -> list[Parameter]:
    """The unknowns with the given names; they start at the values of the scene."""
    found = [_parameter(name, library, scene, asked) for name in names]
    seen: dict[str, str] = {}
    for parameter in found:
        motors = [f"{CONSTANT}[{i + 1}]" for i in CONSTANTS.get(parameter.name, ())]
        for member in parameter.members or motors or (parameter.name,):
            if member in seen:
                raise TwinError(f"{member} is {asked.done} twice: in {seen[member]} and in {parameter.name}")
            seen[member] = parameter.name
    return found


def trusted(sought: Sequence[Parameter], library: Library) -> Array:
    """Prior standard deviations of the scene's lengths and mounting angles, in sizes; infinite for all other unknowns.

    They are the same as in a twin: the tolerances of a workshop.
    """
    widths = np.full(len(sought), np.inf)
    for k, parameter in enumerate(sought):
        is_length = parameter.name.endswith((".length", ".distance", ".com"))
        if is_length or parameter.name in OFFSETS:
            width = library.variable(f"estimator.sigma0.{'length' if is_length else 'offset'}").start
            widths[k] = float(width) / max(parameter.bar(1.0))
    return widths


def _parameter(name: str, library: Library, scene: Values, asked: Asked) -> Parameter:
    if name in ADDITIONS and name in asked.examples:
        unit, size = ADDITIONS[name]
        return Parameter(name, unit, (), (float(scene.get(name, 0.0)),), False, size, -10.0, 0.0)
    if name in CONSTANTS and CONSTANT in asked.examples:
        # A negative constant says that the sign is wrong.
        return Parameter(name, "N.m/A", (), (1.0,), True, 1.0, -1e3, 1.0)
    members = _members(name, library, asked)
    first = library.variable(members[0])
    unit = first.unit or getattr(first.declaredType, "unit", None) or "1"
    base = tuple(float(scene.get(member, library.variable(member).start)) for member in members)
    if unit == "rad":
        # The weight in the plane does not depend on small tilts of an upright machine, and is the same on both sides.
        upright = name == "gravity.tilt" and abs(math.cos(base[0])) < UPRIGHT
        return Parameter(name, unit, members, base, False, MUCH_ANGLE, -20.0, -0.5 if upright else 0.0)
    if name == COMMANDS:
        return Parameter(name, unit, members, base, False, MUCH_DELAY, -base[0] / MUCH_DELAY, 0.0 if base[0] else 0.1)
    switch = SWITCHES.get(name.partition(".")[0])
    off = switch is not None and not scene.get(switch, False)
    if off or not any(base):
        # A factor on 0 has no effect, so that the unit's default gives the typical upper size.
        size = max((abs(float(library.variable(member).start)) for member in members), default=0.0) or 1.0
        return Parameter(name, unit, members, (0.0,) * len(members), False, size, 0.0, 0.1)
    rigid = name.endswith((".mass", ".length", ".distance", ".com", ".inertia")) and not name.startswith("payload")
    return Parameter(name, unit, members, base, True, 1.0, 0.02 if rigid else 0.0, 1.0)


def _members(name: str, library: Library, asked: Asked) -> tuple[str, ...]:
    """The variables for a name: with a list of indices in brackets, or all indices without brackets."""
    found = BRACKETS.search(name)
    if found:
        members = tuple(
            name[: found.start()] + f"[{index}]" + name[found.end() :] for index in found[1].split(",") if index
        )
    elif name in library.variables:
        members = (name,)
    else:
        members = tuple(other for other in library.variables if BRACKETS.sub("", other) == name)
    for member in members or (name,):
        variable = library.variables.get(member)
        if (
            variable is None
            or variable.causality != "parameter"
            or variable.type != "Real"
            or member.startswith(("solver.", "estimator.", "init."))
        ):
            raise TwinError(
                f"{name} cannot be {asked.done}: {member} is not a parameter of the machine; {', '.join(asked.examples)} are examples"
            )
    return members


def assemble(scene: Values, library: Library, sought: Sequence[Parameter], x: Sequence[float]) -> Values:
    """Start values of the unit and mounting angles of its encoders for given values of the unknowns."""
    values = dict(scene)

    def scale(member: str, factor: float) -> None:
        if member not in given:
            values[member] = float(values.get(member, library.variable(member).start)) * factor

    given = {member for parameter in sought for member in parameter.members}
    for parameter, number in zip(sought, x, strict=True):
        if parameter.name in OFFSETS:
            [values[parameter.name]] = parameter.value(number)
        if not parameter.members:
            continue
        switch = SWITCHES.get(parameter.name.partition(".")[0])
        if switch:
            values[switch] = True
        for member, base, value in zip(parameter.members, parameter.base, parameter.value(number), strict=True):
            values[member] = value
            factor = value / base if base else None
            if member.startswith("link[") and factor is not None:
                link = member.partition(".")[0]
                if member.endswith(".mass"):
                    scale(f"{link}.inertia", factor)
                elif member.endswith(".length") and f"{link}.com" not in given:
                    scale(f"{link}.com", factor)
                    scale(f"{link}.inertia", factor**2)
            elif member.startswith("friction.coulomb["):
                breakaway = member.replace("coulomb", "breakaway")
                if breakaway not in given:
                    # In the proportion of the scene, or of the unit's defaults if the scene has no friction.
                    slip, stick = (float(scene.get(n, library.variable(n).start)) for n in (member, breakaway))
                    values[breakaway] = value * (stick / slip if slip else 1.0)
    _friction_of_others(values, scene, library, sought)
    return values


def _friction_of_others(values: Values, scene: Values, library: Library, sought: Sequence[Parameter]) -> None:
    """Sets friction to 0 in joints without a fitted friction, if friction is off in the scene and only on for the fit."""
    for prefix, switch in (("viscous.b", "viscous.enabled"), ("friction.", "friction.enabled")):
        if not values.get(switch) or scene.get(switch):
            continue
        touched = {member for p in sought for member in p.members}
        touched |= {member.replace("coulomb", "breakaway") for member in touched}
        for name, variable in library.variables.items():
            if name.startswith(prefix) and "[" in name and variable.causality == "parameter" and name not in touched:
                values[name] = 0.0


def shown(values: Mapping[str, float | int | bool]) -> str:
    """Values as text for sentences."""
    return ", ".join(f"{name} = {value:g}" for name, value in values.items())
