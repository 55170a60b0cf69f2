"""Following a real machine: its encoders correct the twin, which predicts 0.5 s ahead, rolls back and continues.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/resynchronise.py
Here the machine is a second unit with a payload that the twin does not know; encoders of 16 bits measure it every 1 ms.
The twin estimates the unknown forces and keeps them constant while it predicts; the bands are two standard deviations.
"""

from collections.abc import Sequence
from math import pi, sqrt
from time import perf_counter

from fivebar import Unit

MACHINE = {
    "servo.enabled": True,
    "servo.theta[1]": 1.7,
    "servo.theta[2]": 2.0,
    "init.theta[1]": 1.2,
    "init.theta[2]": 1.6,
}
MACHINE |= {"servo.kp[1]": 1.0, "servo.kp[2]": 1.0, "servo.kd[1]": 0.01, "servo.kd[2]": 0.01}
"""Soft servos that move to another posture."""

INTERVAL, AHEAD, SAMPLE = 0.1, 0.5, 1e-3
COUNT = 2 * pi / 2**16
ENCODERS = {"estimator.enabled": True, "estimator.quantum[1]": COUNT, "estimator.quantum[2]": COUNT}
ENCODERS |= {"estimator.sigma0.length": 0.0, "estimator.sigma0.offset": 0.0, "estimator.sigma0.eccentricity": 0.0}
"""This machine has exact lengths and encoder mounting angles, and the twin is configured accordingly."""


def measured(machine: Unit) -> dict[str, Sequence[float]]:
    """Samples of the motor encoders with their times."""
    angles = [round(angle / COUNT) * COUNT for angle in machine["theta"]]
    return {"measured.theta": angles, "measured.time": (machine.time, machine.time)}


with Unit(**MACHINE, **{"payload.enabled": True, "payload.mass": 0.02}) as machine, Unit(**MACHINE, **ENCODERS) as twin:
    predictions: dict[int, tuple[float, float]] = {}
    print(
        "time (s)  error now (mm)  band (mm)  error of the prediction made 0.5 s before (mm)  a corrected sample takes (us)"
    )
    for sample in range(11):
        now = twin.state()
        twin.step(AHEAD)
        predictions[sample + round(AHEAD / INTERVAL)] = twin.get("tip.x", "tip.y")
        twin.restore(now)

        x, y, xx, yy = twin.get("tip.x", "tip.y", "estimated.tip.cov[1]", "estimated.tip.cov[3]")
        tip = machine.get("tip.x", "tip.y")
        seen = predictions.get(sample)
        ahead = f"{1e3 * ((tip[0] - seen[0]) ** 2 + (tip[1] - seen[1]) ** 2) ** 0.5:.3f}" if seen else "-"
        error = 1e3 * ((tip[0] - x) ** 2 + (tip[1] - y) ** 2) ** 0.5

        spent = 0.0
        for _ in range(round(INTERVAL / SAMPLE)):
            values, begin = measured(machine), perf_counter()
            twin.update(values)
            twin.step(SAMPLE)
            spent += perf_counter() - begin
            machine.step(SAMPLE)
        each = 1e6 * spent * SAMPLE / INTERVAL
        print(f"{machine.time - INTERVAL:8.1f}  {error:14.3f}  {2e3 * sqrt(xx + yy):9.3f}  {ahead:>47}  {each:29.0f}")
