"""Pinocchio's constrained dynamics (two legs, their ends joined) under this file's RK4: Pinocchio itself brings no integrator.

The loop is kept by Pinocchio's own Baumgarte correction.
"""

import numpy as np
import pinocchio as pin

from machine import BASE, COM, INERTIA, LENGTH, MASS, G, Peer, Setting

STEPS = (1e-3, 1e-4)
# Baumgarte gains: a correction time constant of 10 ms, well above the steps.
GAIN = 100.0


def peer() -> Peer:
    return Peer("Pinocchio", pin.__version__, (_setting(step) for step in STEPS))


def _model() -> tuple:
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -G, 0.0])
    ends = []
    for side, x in (("left", 0.0), ("right", BASE)):
        parent, place = 0, np.array([x, 0.0, 0.0])
        for name in ("proximal", "distal"):
            parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3(np.eye(3), place), f"{side} {name}")
            body = pin.Inertia(MASS, np.array([COM, 0.0, 0.0]), np.diag([INERTIA] * 3))
            model.appendBodyToJoint(parent, body, pin.SE3.Identity())
            place = np.array([LENGTH, 0.0, 0.0])
        ends.append((parent, pin.SE3(np.eye(3), place)))
    (left, left_end), (right, right_end) = ends
    loop = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, left, left_end, right, right_end, pin.ReferenceFrame.LOCAL)
    loop.corrector.Kp[:] = GAIN**2
    loop.corrector.Kd[:] = 2 * GAIN
    return model, loop


def _setting(step: float) -> Setting:
    def begin(start):
        model, loop = _model()
        data, constraints = model.createData(), [loop]
        constraint_data = [loop.createData()]
        # The loop's third direction is out of the plane: the proximal regularisation makes the system solvable.
        solver = pin.ProximalSettings(1e-14, 1e-12, 10)
        pin.initConstraintDynamics(model, data, constraints)
        a, b, c, d = start[:4]
        q, v, done, none = np.array([a, b - a, d, c - d]), np.zeros(4), 0, np.zeros(4)

        def accelerations(q, v):
            return pin.constraintDynamics(model, data, q, v, none, constraints, constraint_data, solver).copy()

        def advance(until):
            nonlocal q, v, done
            steps = round(until / step)
            for _ in range(steps - done):
                k1 = accelerations(q, v)
                k2 = accelerations(q + step / 2 * v, v + step / 2 * k1)
                k3 = accelerations(q + step / 2 * v + step**2 / 4 * k1, v + step / 2 * k2)
                k4 = accelerations(q + step * v + step**2 / 2 * k2, v + step * k3)
                q, v = q + step * v + step**2 / 6 * (k1 + k2 + k3), v + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            done = steps
            (p, s, r, u), (w, x, y, z) = q, v
            return np.array([p, p + s, r + u, r, w, w + x, y + z, y])

        return advance

    return Setting(f"CONTACT_3D loop, Baumgarte {GAIN:g}/s, RK4 in Python, h = {step:g} s", begin)
