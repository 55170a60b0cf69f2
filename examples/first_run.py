"""The shortest example: FMPy, start values, a torque, and the position of the tip after one second."""

from fmpy import simulate_fmu

import fivebar

result = simulate_fmu(
    str(fivebar.unit()),
    stop_time=1,
    start_values={"init.theta[2]": 2.0944, "tau[1]": 0.01},
    output=["tip.x", "tip.y"],
)
print(f"tip after {result['time'][-1]:g} s: x = {result['tip.x'][-1]:.6f} m, y = {result['tip.y'][-1]:.6f} m")
