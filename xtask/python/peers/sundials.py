"""SUNDIALS' CVODE and IDA, through scikit-sundae; right side and residual are compiled by numba and called through Python."""

import numpy as np
import sksundae

from machine import Peer, Setting, derivative, multipliers, residual

TOLERANCES = (1e-6, 1e-8, 1e-10, 1e-12)
STEPS = 10_000_000  # no limit in effect


def cvode() -> Peer:
    return Peer("SUNDIALS CVODE", _version(), (_adams(tolerance) for tolerance in TOLERANCES))


def ida() -> Peer:
    return Peer("SUNDIALS IDA", _version(), (_index_1(tolerance) for tolerance in TOLERANCES))


def _version() -> str:
    return f"{sksundae.SUNDIALS_VERSION} (scikit-sundae {sksundae.__version__})"


def _adams(tolerance: float) -> Setting:
    def right_side(t, y, yp):
        yp[:] = derivative(t, y)

    def begin(start):
        solver = sksundae.cvode.CVODE(right_side, method="Adams", rtol=tolerance, atol=tolerance, max_num_steps=STEPS)
        solver.init_step(0.0, start)

        def advance(until):
            return _checked(solver.step(until)).y

        return advance

    return Setting(f"Adams, 4 angles, rtol = atol = {tolerance:g}", begin)


def _index_1(tolerance: float) -> Setting:
    def function(_t, y, yp, res):
        residual(y, yp, res)

    def begin(start):
        y = np.concatenate([start, multipliers(start)])
        yp = np.concatenate([derivative(0.0, start), np.zeros(2)])
        options = {"rtol": tolerance, "atol": tolerance, "algebraic_idx": [8, 9], "max_num_steps": STEPS}
        solver = sksundae.ida.IDA(function, **options)
        solver.init_step(0.0, y, yp)

        def advance(until):
            return _checked(solver.step(until)).y[:8]

        return advance

    return Setting(f"BDF, index 1, 4 angles and 2 multipliers, rtol = atol = {tolerance:g}", begin)


def _checked(solution):
    if not solution.success:
        raise RuntimeError(solution.message)
    return solution
