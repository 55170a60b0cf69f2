"""Methods of this repository, through the packed .fmu, for comparison with the peers."""

import math
from functools import partial
from pathlib import Path

import numpy as np

import ahead
import machine
from fivebar.instance import Unit
from fivebar.library import Library
from machine import Peer, Setting

STATE = (
    "theta[1]",
    "passive.theta[1]",
    "passive.theta[2]",
    "theta[2]",
    "omega[1]",
    "passive.omega[1]",
    "passive.omega[2]",
    "omega[2]",
)

# Name in the report, then the method in the model description; a method that this .fmu lacks is skipped.
RUNS = {
    "i3alp, adaptive": (
        "i3alp",
        [{"solver.adaptive": True, "solver.errorTolerance": x} for x in (3e-7, 3e-9, 1e-11, 1e-13)],
    ),
    "i3alp, fixed step": ("i3alp", [{"solver.adaptive": False, "solver.stepSize": h} for h in (1e-3, 1e-4, 1e-5)]),
    "i3alpConserving": ("i3alpConserving", [{"solver.stepSize": h} for h in (4e-3, 2e-3, 1e-3, 1e-4)]),
    "rk4": ("rk4", [{"solver.stepSize": h} for h in (4e-3, 2e-3, 1e-3, 1e-4, 2e-5)]),
    "dop853": ("dop853", [{"solver.errorTolerance": 10.0**-n} for n in range(3, 15)]),
    "automatic": ("automatic", [{"solver.errorTolerance": 10.0**-n} for n in range(3, 15)]),
}


def peers(fmu: Path) -> list[Peer]:
    library = Library(fmu)
    version = library.model.version or "this .fmu"
    return [
        Peer(
            f"{ahead.OURS}{name}",
            version,
            [_setting(library, run | {"solver.method": method}) for run in runs],
        )
        for name, (method, runs) in RUNS.items()
        if method in library.known["solver.method"].items
    ]


# Values of the scene servo_friction besides its start; friction uses its start values.
LOADED = {"servo.enabled": True, "viscous.enabled": True, "friction.enabled": True} | {
    f"servo.{name}[{motor}]": value
    for name, pair in {
        "kp": (machine.KP, machine.KP),
        "kd": (machine.KD, machine.KD),
        "limit": (machine.LIMIT, machine.LIMIT),
        "theta": machine.REFERENCES,
    }.items()
    for motor, value in enumerate(pair, 1)
}


def _setting(library: Library, settings: dict[str, float | bool | str]) -> Setting:
    text = ", ".join(f"{name} = {value}" for name, value in settings.items() if name != "solver.method")

    def begin(start, loads=None):
        unit = Unit.of(library)
        # Equal distal links: the tip is on the right if the turn from the left one to the right one is clockwise.
        side = "plus" if math.sin(start[2] - start[1]) >= 0 else "minus"
        place = {"init.theta[1]": start[0], "init.theta[2]": start[3], "init.assembly": side}
        unit.reset(**place | (loads or {}) | settings)

        def advance(until):
            unit.step_to(until)
            return np.array(unit.numbers(STATE))

        return advance

    return Setting(text, begin, begin_loaded=partial(begin, loads=LOADED))
