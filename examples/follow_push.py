"""Estimate, truth, bands and alarm while a robot moves an unknown payload and its tip is pushed; the twin does not know the push.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/follow_push.py
The picture is target/follow_push.svg. Encoders of 16 bits measure the machine every 1 ms.
"""

from math import pi, sqrt
from pathlib import Path

from matplotlib.figure import Figure

from fivebar import Unit
from fivebar.kinematics import Machine

STEP, COUNT = 1e-3, 2 * pi / 2**16
MACHINE = {"base.distance": 0.1, "gravity.enabled": False, "init.theta[1]": 2.7567, "init.theta[2]": 1.345}
MACHINE |= {"servo.enabled": True, "servo.kp[1]": 20.0, "servo.kp[2]": 20.0, "servo.kd[1]": 0.5, "servo.kd[2]": 0.5}
PAYLOAD = {"payload.enabled": True, "payload.mass": 0.02}
ENCODERS = {"estimator.enabled": True, "estimator.quantum[1]": COUNT, "estimator.quantum[2]": COUNT}
ENCODERS |= {"estimator.sigma0.theta": 0.01, "estimator.sigma0.length": 0.0}
ENCODERS |= {"estimator.sigma0.offset": 0.0, "estimator.sigma0.eccentricity": 0.0}
"""This machine has exact lengths and encoder mounting angles, and the twin is configured accordingly."""
PUSH, FROM, TO = 0.5, 0.75, 0.85
GEOMETRY = Machine(0.1, (0.21, 0.21, 0.21, 0.21))


def reference(time: float) -> dict[str, float]:
    """Servo references of a motion there and back with minimum jerk."""

    def jerk(begin: float) -> tuple[float, float]:
        s = min(max((time - begin) / 0.5, 0.0), 1.0)
        return s**3 * (10 - 15 * s + 6 * s * s), 30 * s * s * (1 - s) ** 2 / 0.5

    part, speed = (there - back for there, back in zip(jerk(0.2), jerk(0.9)))
    angles = {f"servo.theta[{i}]": start - 0.9601 * part for i, start in ((1, 2.7567), (2, 1.345))}
    return angles | {f"servo.omega[{i}]": -0.9601 * speed for i in (1, 2)}


rows = []
with Unit(**MACHINE, **PAYLOAD) as machine, Unit(**MACHINE, **ENCODERS) as twin:
    while machine.time < 1.6 - STEP / 2:
        drive = reference(machine.time + STEP / 2)
        twin["measured.theta"] = [round(angle / COUNT) * COUNT for angle in machine["theta"]]
        twin["measured.time"] = machine.time, machine.time
        twin.update(drive)
        force = PUSH if FROM <= machine.time < TO else 0.0
        machine.update(drive | {"tip.fy": force})
        machine.step(STEP), twin.step(STEP)
        tip = ("tip.x", "tip.y")
        names = (*tip, "estimated.tip.cov[3]", "estimated.tau[1]", "estimated.tau.sigma[1]", "estimated.alarm")
        # By virtual work, the push acts like a torque of d tip.y / d theta[1] times its force.
        lever = GEOMETRY.jacobian(GEOMETRY.forward(machine["theta"]).theta)[1, 0]
        rows.append((machine.time, *machine.get(*tip), *twin.get(*names), force * lever))

time, x, y, ex, ey, variance, tau, sigma, alarm, push = (list(column) for column in zip(*rows))
sigma = [min(value, 1.0) for value in sigma]
figure = Figure(figsize=(8, 8), layout="constrained")
way, error, force = figure.subplots(3, 1, sharex=True)
way.plot(time, y, label="truth"), way.plot(time, ey, "--", label="estimate")
way.set_ylabel("tip.y (m)")
error.plot(time, [1e6 * (a - b) for a, b in zip(y, ey)], lw=0.7, label="truth - estimate")
band = [2e6 * sqrt(value) for value in variance]
error.fill_between(time, [-value for value in band], band, alpha=0.3, label="two standard deviations")
error.set_ylabel("tip.y (µm)"), error.set_ylim(-60, 60)
force.plot(time, tau, label="estimated.tau[1]")
low, high = ([t + k * s for t, s in zip(tau, sigma)] for k in (-2, 2))
force.fill_between(time, low, high, alpha=0.3, label="two standard deviations")
force.plot(time, push, "--", color="black", lw=1, label="torque of the push")
force.fill_between(time, -0.2, 0.2, where=[value > 0.5 for value in alarm], color="tab:red", alpha=0.2, label="alarm")
force.axvspan(FROM, TO, color="grey", alpha=0.2, label="push of 0.5 N")
force.set_ylabel("unknown torque (N m)"), force.set_xlabel("time (s)"), force.set_ylim(-0.2, 0.2)
for panel in (way, error, force):
    panel.legend(loc="upper right", fontsize="small"), panel.grid(alpha=0.3)
Path("target").mkdir(exist_ok=True)
figure.savefig("target/follow_push.svg", metadata={"Date": None})
off = [sqrt((a - c) ** 2 + (b - d) ** 2) for t, a, b, c, d, *_ in rows if t > 0.1]
raised = [t for t, value in zip(time, alarm) if value > 0.5]
first = next((t for t in raised if t >= FROM), None)
print(f"tip error {1e3 * sqrt(sum(e * e for e in off) / len(off)):.4f} mm (root of the mean square)")
print(f"alarm {1e3 * (first - FROM):.0f} ms after the push" if first else "no alarm after the push")
print("target/follow_push.svg")
