"""How fine an encoder must be: error of the estimated tip for each resolution and sampling rate.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/encoder_resolution.py
Soft servos move the machine there and back with a payload of 20 g that the twin does not know. Errors are root mean squares
in mm from 0.1 s on. The last column is the error of the reading itself, without a twin.
"""

from math import pi

import numpy as np

from fivebar import Unit
from fivebar.kinematics import Machine

MACHINE = {"base.distance": 0.1, "gravity.enabled": False, "init.theta[1]": 2.7567, "init.theta[2]": 1.345}
MACHINE |= {"servo.enabled": True, "servo.kp[1]": 5.0, "servo.kp[2]": 5.0, "servo.kd[1]": 0.1, "servo.kd[2]": 0.1}
PAYLOAD = {"payload.enabled": True, "payload.mass": 0.02}
EXACT = {f"estimator.sigma0.{name}": 0.0 for name in ("length", "offset", "eccentricity")}
"""Lengths and mounting angles are exact, so the table shows only the effect of the encoders."""
GEOMETRY = Machine(0.1, (0.21, 0.21, 0.21, 0.21))
STEP, END = 1e-3, 1.2
BITS, RATES = (10, 12, 14, 16, 18), (100, 250, 1000)


def swing(time: float) -> list[float]:
    """References of both servos, rad: a swing there and back."""
    turn = 0.48 * (1 - np.cos(2 * pi * time / END))
    return [2.7567 - turn, 1.345 - turn]


with Unit(**MACHINE, **PAYLOAD) as machine:
    truth = [(machine["theta"], machine.get("tip.x", "tip.y"))]
    for k in range(round(END / STEP)):
        machine["servo.theta"] = swing(k * STEP)
        machine.step(STEP)
        truth.append((machine["theta"], machine.get("tip.x", "tip.y")))
tips = np.array([tip for _, tip in truth])


def error(found: np.ndarray) -> float:
    """Root mean square error of the tip, mm."""
    return 1e3 * float(np.sqrt(np.mean(np.sum((found - tips)[100:] ** 2, axis=1))))


print("bits  step (mrad)  " + "  ".join(f"{rate:5} Hz" for rate in RATES) + "   reading")
for bits in BITS:
    count = 2 * pi / 2**bits
    readings = [np.round(theta / count) * count for theta, _ in truth]
    found = []
    for rate in RATES:
        stride = round(1 / (rate * STEP))
        quantum = {f"estimator.quantum[{i}]": count for i in (1, 2)}
        with Unit(**MACHINE, **EXACT, **quantum, **{"estimator.enabled": True, "estimator.sigma0.theta": 0.01}) as twin:
            estimate = [twin.get("tip.x", "tip.y")]
            for k in range(round(END / STEP)):
                if k % stride == 0:
                    twin["measured.theta"], twin["measured.time"] = readings[k], (k * STEP, k * STEP)
                twin["servo.theta"] = swing(k * STEP)
                twin.step(STEP)
                estimate.append(twin.get("tip.x", "tip.y"))
        found.append(error(np.array(estimate)))
    read = error(GEOMETRY.forward(np.array(readings)).tip)
    print(f"{bits:4}  {1e3 * count:11.3f}  " + "  ".join(f"{value:8.4f}" for value in found) + f"  {read:8.4f}")
