"""Methods of this repository, through the packed .fmu, for comparison with the peers."""

import math
from functools import partial
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException

import ahead
import machine
from fivebar.slave import Log, get_values, instantiate, set_values
from machine import Peer, Setting

STATE = [
    "theta[1]",
    "passive.theta[1]",
    "passive.theta[2]",
    "theta[2]",
    "omega[1]",
    "passive.omega[1]",
    "passive.omega[2]",
    "omega[2]",
]

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
    directory = fmpy.extract(str(fmu))
    model = fmpy.read_model_description(directory, validate=False)
    method = next(v for v in model.modelVariables if v.name == "solver.method")
    numbers = {item.name: int(item.value) for item in method.declaredType.items}
    assembly = next(v for v in model.modelVariables if v.name == "init.assembly")
    sides = {item.name: int(item.value) for item in assembly.declaredType.items}
    version = model.version or "this .fmu"
    return [
        Peer(
            f"{ahead.OURS}{name}",
            version,
            [_setting(model, directory, sides, run | {"solver.method": numbers[method]}) for run in runs],
        )
        for name, (method, runs) in RUNS.items()
        if method in numbers
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


def _setting(model, directory: str, sides: dict[str, int], settings: dict[str, float | bool]) -> Setting:
    text = ", ".join(f"{name} = {value}" for name, value in settings.items() if name != "solver.method")

    def begin(start, loads=None):
        log = Log()
        slave = instantiate(model, directory, log)
        # Equal distal links: the tip is on the right if the turn from the left one to the right one is clockwise.
        side = sides["plus" if math.sin(start[2] - start[1]) >= 0 else "minus"]
        set_values(
            slave,
            model,
            {"init.theta[1]": start[0], "init.theta[2]": start[3], "init.assembly": side} | (loads or {}) | settings,
        )
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        now = 0.0

        def advance(until):
            nonlocal now
            try:
                slave.doStep(now, until - now)
            except FMICallException as error:
                raise RuntimeError(log.last() or str(error)) from None
            now = until
            return np.array(list(get_values(slave, model, STATE).values()))

        return advance

    return Setting(text, begin, begin_loaded=partial(begin, loads=LOADED))
