"""Following a real machine: measure, start the twin anew from what was measured, look 0.5 s ahead, roll back, go on.

`cargo xtask package` makes the .fmu; from the root of the repository: target/venv/bin/python examples/resynchronise.py
Here the machine is a second unit that carries a payload of which the twin knows nothing; encoders of 16 bits measure it.
Measured angles enter by fmi2Reset and init.*: an angle is no input, so that the state is always one that closes the loop.
What that costs in the library: row `re-synchronise` of `cargo xtask bench`; FMPy adds its own.
"""

from math import pi
from time import perf_counter

from unit import Unit

MACHINE = {"servo.enabled": True, "servo.theta[1]": 1.7, "servo.theta[2]": 2.0, "init.theta[1]": 1.2, "init.theta[2]": 1.6}
MACHINE |= {"servo.kp[1]": 1.0, "servo.kp[2]": 1.0, "servo.kd[1]": 0.01, "servo.kd[2]": 0.01}
"""Soft servos that swing to another posture."""

INTERVAL, AHEAD = 0.1, 0.5
COUNT = 2 * pi / 2**16


def measured(machine: Unit) -> dict[str, float]:
    """What the encoders of the motors say, and on which side the tip is, as starting values."""
    names = ["theta[1]", "theta[2]", "omega[1]", "omega[2]"]
    *values, assembly = machine.get(*names, "mode.assembly")
    return {f"init.{name}": round(x / COUNT) * COUNT for name, x in zip(names, values)} | {"init.assembly": assembly}


with Unit(**MACHINE, **{"payload.enabled": True, "payload.mass": 0.02}) as machine, Unit(**MACHINE) as twin:
    machine.start({})
    predictions: dict[int, tuple[float, float]] = {}
    print("time (s)  error of the prediction made 0.5 s before (mm)  re-synchronised in (us)")
    for sample in range(11):
        tip = machine.get("tip.x", "tip.y")
        seen = predictions.get(sample)
        error = f"{1e3 * ((tip[0] - seen[0]) ** 2 + (tip[1] - seen[1]) ** 2) ** 0.5:.3f}" if seen else "-"

        values, begin = measured(machine), perf_counter()
        if sample:
            twin.slave.reset()
        twin.start(values, machine.time)
        twin.step(1e-3)
        spent = perf_counter() - begin

        now, time = twin.slave.getFMUstate(), twin.time
        twin.step(AHEAD - 1e-3)
        predictions[sample + round(AHEAD / INTERVAL)] = tuple(twin.get("tip.x", "tip.y"))
        twin.slave.setFMUstate(now)
        twin.slave.freeFMUstate(now)
        twin.time = time
        print(f"{machine.time:8.1f}  {error:>47}  {1e6 * spent:23.0f}")

        machine.step(INTERVAL)
