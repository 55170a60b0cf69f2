"""How many predictions a second a twin can make through FMPy, on one core: stored state, torque, one doStep of 0.5 s, tip read, back.

`cargo xtask package` makes the .fmu; then `target/venv/bin/python xtask/python/look_ahead.py`. docs/twin.md has the figures.
"""

import shutil
import time
from pathlib import Path

from fmpy import extract, read_model_description
from fmpy.simulation import instantiate_fmu

FMU = Path(__file__).resolve().parents[2] / "target" / "fmu" / "FiveBar.fmu"

SERVO = {"init.theta[2]": 2.0944, "payload.enabled": True, "servo.enabled": True, "servo.theta[1]": 1.6, "servo.theta[2]": 2.0}
STRONG = {f"servo.{name}[{side}]": value for name, value in (("kp", 200.0), ("kd", 2.0), ("limit", 50.0)) for side in (1, 2)}
MACHINES = {
    "servo, payload, dry friction": SERVO | {"friction.enabled": True},
    "servo, payload": SERVO,
    "servo of 200 N.m/rad, payload": SERVO | STRONG,
}
METHODS = {"dop853": 4, "automatic": 6}
TOLERANCES = (1e-4, 1e-6, 3e-9)
SECONDS = 1.0
"""For how long each row is measured."""


def per_second(folder: str, values: dict[str, float | bool]) -> float:
    """Predictions a second of a machine."""
    model = read_model_description(folder)
    variables = {v.name: (v.type.replace("Enumeration", "Integer"), v.valueReference) for v in model.modelVariables}
    slave = instantiate_fmu(folder, model, "CoSimulation")
    for name, value in values.items():
        kind, reference = variables[name]
        getattr(slave, f"set{kind}")([reference], [value])
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    slave.doStep(0.0, 0.2)
    now, count = slave.getFMUstate(), 0
    begin = time.perf_counter()
    while time.perf_counter() - begin < SECONDS:
        slave.setReal([variables["tau[1]"][1]], [0.01 * (count % 5)])
        slave.doStep(0.2, 0.5)
        slave.getReal([variables["tip.y"][1]])
        slave.setFMUstate(now)
        count += 1
    rate = count / (time.perf_counter() - begin)
    slave.freeFMUstate(now)
    slave.freeInstance()
    return rate


def main() -> None:
    """Prints a row for each machine and tolerance."""
    folder = extract(str(FMU))
    print("| machine | solver.errorTolerance | " + " | ".join(METHODS) + " |\n| --- | --- |" + " ---: |" * len(METHODS))
    for machine, values in MACHINES.items():
        for tolerance in TOLERANCES:
            settings = {"solver.errorTolerance": tolerance}
            rates = [per_second(folder, values | settings | {"solver.method": number}) for number in METHODS.values()]
            print(f"| {machine} | {tolerance:g} rad | " + " | ".join(f"{rate:,.0f}" for rate in rates) + " |", flush=True)
    shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
