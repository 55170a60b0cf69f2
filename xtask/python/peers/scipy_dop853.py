"""SciPy's DOP853 on the four link angles; the right side is compiled by numba."""

from functools import partial

import scipy
from scipy.integrate import solve_ivp

from machine import Peer, Setting, derivative, loaded_derivative

TOLERANCES = tuple(10.0**-n for n in range(3, 14))


def peer() -> Peer:
    return Peer("SciPy DOP853", scipy.__version__, (_setting(tolerance) for tolerance in TOLERANCES))


def _setting(tolerance: float) -> Setting:
    def begin(start, right_side=derivative):
        now, y = 0.0, start

        def advance(until):
            nonlocal now, y
            solution = solve_ivp(right_side, (now, until), y, method="DOP853", rtol=tolerance, atol=tolerance)
            if not solution.success:
                raise RuntimeError(solution.message)
            now, y = until, solution.y[:, -1]
            return y

        return advance

    text = f"4 angles, rtol = atol = {tolerance:g}, right side by numba"
    return Setting(text, begin, begin_loaded=partial(begin, right_side=loaded_derivative))
