"""A custom scene in FMPy: a small machine, springs that carry its weight, and a push on its tip.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/own_scene.py
A scene file for `fivebar run` does the same without code: see docs/scenes.md.
"""

import numpy as np
from fmpy import read_model_description, simulate_fmu

import fivebar

FMU = str(fivebar.unit())

# The machine: uniform rods as links (10 cm, 15 g and 12 cm, 18 g), and motors 8 cm apart.
start = {"base.distance": 0.08}
for link, length, mass in ((1, 0.10, 0.015), (2, 0.12, 0.018), (3, 0.12, 0.018), (4, 0.10, 0.015)):
    start |= {
        f"link[{link}].length": length,
        f"link[{link}].mass": mass,
        f"link[{link}].com": length / 2,
        f"link[{link}].inertia": mass * length**2 / 12,
    }

# The start: elbows apart and the tip above them (`plus`). FMPy takes enumerations by number.
start |= {"init.theta[1]": 2.2, "init.theta[2]": 0.94, "init.assembly": 1}

# The effects: gravity, springs stiff enough to carry the machine, and some friction.
start |= {"spring.enabled": True, "viscous.enabled": True}
for side, relaxed in ((1, 2.2), (2, 0.94)):
    start |= {f"spring.k[{side}]": 0.5, f"spring.theta0[{side}]": relaxed}

# The push: 0.5 N to the right, rising and falling over 0.2 s. FMPy interpolates between two rows; the unit keeps inputs constant
# during a communication step (here 1 ms). The table lists all inputs, unused ones at 0, because FMPy warns of each missing one.
time = np.linspace(0, 2, 201)
inputs = [variable.name for variable in read_model_description(FMU).modelVariables if variable.causality == "input"]
push = np.zeros(len(time), dtype=[(name, float) for name in ("time", *inputs)])
push["time"] = time
push["tip.fx"] = np.where((time > 0.5) & (time < 0.7), 0.5 * np.sin(np.pi * (time - 0.5) / 0.2) ** 2, 0)

result = simulate_fmu(
    FMU,
    stop_time=2,
    output_interval=1e-3,
    start_values=start,
    input=push,
    output=["tip.x", "tip.y", "energy.input", "energy.dissipated", "energy.error"],
)

furthest = np.argmax(np.abs(result["tip.x"] - result["tip.x"][0]))
print(f"at the start  tip at x = {result['tip.x'][0]:.4f} m, y = {result['tip.y'][0]:.4f} m")
print(f"furthest      tip at x = {result['tip.x'][furthest]:.4f} m at t = {result['time'][furthest]:.3f} s")
print(f"at the end    tip at x = {result['tip.x'][-1]:.4f} m, y = {result['tip.y'][-1]:.4f} m")
print(
    f"work of the push {1e3 * result['energy.input'][-1]:.3f} mJ, dissipated {1e3 * result['energy.dissipated'][-1]:.3f} mJ"
)
print(f"largest balance residual {np.max(np.abs(result['energy.error'])):.1e} J")
