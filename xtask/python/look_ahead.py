"""Predictions per second of a twin through FMPy on one core: restore a stored state, set the torque, one doStep of 0.5 s, read the tip.

python look_ahead.py --fmu target/fmu/FiveBar.fmu --out target/bench/look-ahead.csv

Part of `cargo xtask bench`; docs/notes/growth.md has the figures. Times are processor times, so that other load on the machine hardly counts.
"""

import argparse
import csv
import shutil
import sys
import time
from pathlib import Path

from fmpy import extract, read_model_description
from fmpy.simulation import instantiate_fmu

SERVO = {
    "init.theta[2]": 2.0944,
    "payload.enabled": True,
    "servo.enabled": True,
    "servo.theta[1]": 1.6,
    "servo.theta[2]": 2.0,
}
STRONG = {
    f"servo.{name}[{side}]": value for name, value in (("kp", 200.0), ("kd", 2.0), ("limit", 50.0)) for side in (1, 2)
}
GOALS = {"servo, payload, dry friction": 1000, "servo, payload": 6000}
"""Target of `automatic` at the default tolerance, predictions per second."""

MACHINES = {
    "servo, payload, dry friction": SERVO | {"friction.enabled": True},
    "servo, payload": SERVO,
    "servo of 200 N.m/rad, payload": SERVO | STRONG,
}
METHODS = {"dop853": 4, "automatic": 6}
TOLERANCES = (1e-4, 1e-6, 3e-9)
DEFAULT = TOLERANCES[-1]

SECONDS = 1.0
"""Duration of the measurement of each row; a tenth of it with --quick."""


def per_second(folder: str, values: dict[str, float | bool], seconds: float) -> float:
    """Predictions per second of a machine, measured for `seconds`."""
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
    begin = time.process_time()
    while time.process_time() - begin < seconds:
        slave.setReal([variables["tau[1]"][1]], [0.01 * (count % 5)])
        slave.doStep(0.2, 0.5)
        slave.getReal([variables["tip.y"][1]])
        slave.setFMUstate(now)
        count += 1
    rate = count / (time.process_time() - begin)
    slave.freeFMUstate(now)
    slave.freeInstance()
    return rate


def main(arguments: list[str] | None = None) -> int:
    """Prints a row for each machine and tolerance, with the target."""
    parser = argparse.ArgumentParser(
        description="Predictions of 0.5 s per second of a twin, through FMPy, on one core."
    )
    parser.add_argument("--fmu", type=Path, required=True, help="the packed .fmu")
    parser.add_argument("--out", type=Path, required=True, help="the CSV file to write")
    parser.add_argument("--quick", action="store_true", help="measure for a tenth of the time")
    options = parser.parse_args(arguments)
    seconds = SECONDS / 10.0 if options.quick else SECONDS
    folder = extract(str(options.fmu))
    print(
        "| machine | solver.errorTolerance | "
        + " | ".join(METHODS)
        + " | goal |\n| --- | --- |"
        + " ---: |" * (len(METHODS) + 1)
    )
    rows = []
    try:
        for machine, values in MACHINES.items():
            for tolerance in TOLERANCES:
                settings = {"solver.errorTolerance": tolerance}
                rates = [
                    per_second(folder, values | settings | {"solver.method": number}, seconds)
                    for number in METHODS.values()
                ]
                goal = GOALS.get(machine, "") if tolerance == DEFAULT else ""
                rows.append([machine, tolerance, *(round(rate) for rate in rates), goal])
                cells = [f"{rate:,.0f}" for rate in rates] + [f"{goal:,}" if goal else ""]
                print(f"| {machine} | {tolerance:g} rad | " + " | ".join(cells) + " |", flush=True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["machine", "tolerance [rad]", *(f"{name} [1/s]" for name in METHODS), "goal [1/s]"])
        writer.writerows(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
