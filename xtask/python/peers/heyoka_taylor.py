"""heyoka: Taylor's method on the four link angles, with an order chosen from the tolerance; LLVM compiles the right side."""

import math
from functools import cache, partial

import heyoka as hy
import numpy as np

from machine import (
    COM,
    COULOMB,
    COULOMB_RATE,
    COUPLING,
    FAR,
    JOINTS,
    KD,
    KP,
    LENGTH,
    LIMIT,
    MASS,
    NEAR,
    REFERENCES,
    STRIBECK,
    STRIBECK_RATE,
    VISCOUS,
    G,
    Peer,
    Setting,
)

TOLERANCES = tuple(10.0**-n for n in range(3, 16))


def peer() -> Peer:
    return Peer("heyoka", hy.__version__, [_setting(tolerance) for tolerance in TOLERANCES])


def _loads(theta: list, omega: list) -> list:
    """Torques of servos and friction on the links."""
    out = [hy.expression(0.0)] * 4
    for first, second in JOINTS:
        w = omega[first] - (omega[second] if second is not None else 0.0)
        u = w / STRIBECK_RATE
        torque = -(STRIBECK * u * hy.exp(-u * u) + COULOMB * hy.tanh(w / COULOMB_RATE) + VISCOUS * w)
        out[first] += torque
        if second is not None:
            out[second] -= torque
    for motor, link in enumerate((0, 3)):
        out[link] += LIMIT * hy.tanh((KP * (REFERENCES[motor] - theta[link]) - KD * omega[link]) / LIMIT)
    return out


def _equations(loaded: bool) -> list:
    """Equations of motion as in machine.py, as expressions."""
    theta, omega = hy.make_vars("a", "b", "c", "d"), hy.make_vars("u", "v", "w", "x")
    sin, cos = [hy.sin(x) for x in theta], [hy.cos(x) for x in theta]
    force = _loads(theta, omega) if loaded else [hy.expression(0.0)] * 4
    off = {}
    for near, far in ((0, 1), (3, 2)):
        off[near] = COUPLING * (cos[near] * cos[far] + sin[near] * sin[far])
        turn = COUPLING * (sin[near] * cos[far] - cos[near] * sin[far])
        force[near] += -turn * omega[far] ** 2 - MASS * G * (COM + LENGTH) * cos[near]
        force[far] += turn * omega[near] ** 2 - MASS * G * COM * cos[far]

    def by_mass(f: list) -> list:
        out = [None] * 4
        for near, far in ((0, 1), (3, 2)):
            det = NEAR * FAR - off[near] ** 2
            out[near], out[far] = (
                (FAR * f[near] - off[near] * f[far]) / det,
                (NEAR * f[far] - off[near] * f[near]) / det,
            )
        return out

    def dot(x: list, y: list):
        return sum((a * b for a, b in zip(x[1:], y[1:])), x[0] * y[0])

    signed = [LENGTH, LENGTH, -LENGTH, -LENGTH]
    jx, jy = [-l * s for l, s in zip(signed, sin)], [l * c for l, c in zip(signed, cos)]
    free, by_x, by_y = by_mass(force), by_mass(jx), by_mass(jy)
    squares = [w**2 for w in omega]
    rx = dot([l * c for l, c in zip(signed, cos)], squares) - dot(jx, free)
    ry = dot([l * s for l, s in zip(signed, sin)], squares) - dot(jy, free)
    xx, xy, yy = dot(jx, by_x), dot(jx, by_y), dot(jy, by_y)
    det = xx * yy - xy * xy
    force_x, force_y = (yy * rx - xy * ry) / det, (xx * ry - xy * rx) / det
    acceleration = [free[i] + force_x * by_x[i] + force_y * by_y[i] for i in range(4)]
    return [*zip(theta, omega), *zip(omega, acceleration)]


@cache
def _integrator(tolerance: float, loaded: bool):
    """Compiled once, because each takes seconds."""
    return hy.taylor_adaptive(_equations(loaded), [0.0] * 8, tol=tolerance)


def _setting(tolerance: float) -> Setting:
    def begin(start, loaded=False):
        integrator = _integrator(tolerance, loaded)
        integrator.time, integrator.state[:] = 0.0, start

        def advance(until):
            outcome = integrator.propagate_until(until)[0]
            if outcome != hy.taylor_outcome.time_limit:
                raise RuntimeError(f"ended with {outcome}")
            return np.array(integrator.state)

        return advance

    text = f"4 angles, Taylor series of order {max(2, math.ceil(1 - math.log(tolerance) / 2))}, tol = {tolerance:g}"
    return Setting(text, begin, begin_loaded=partial(begin, loaded=True))
