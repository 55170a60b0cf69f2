"""A strictly fixed step of 1 ms for real time: the conserving method with bounded work, in a fall through singularities.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/fixed_step.py
See docs/conserving.md for the time that a step takes, and for the effect of the bound.
"""

from fivebar import Unit

STEP = 1e-3
"""Step length, s."""

with Unit(**{"solver.method": "i3alpConserving", "solver.maxWork": 40, "init.theta[2]": 2.0944}) as unit:
    worst = largest = before = 0.0
    for _ in range(10_000):
        unit.step(STEP)
        error, iterations = unit.get("energy.error", "solver.iterations")
        worst, largest, before = max(worst, abs(error)), max(largest, iterations - before), iterations
    steps, substeps, rescued, last = unit.get(*(f"solver.{x}" for x in ("steps", "substeps", "rescued", "lastResorts")))
    position, velocity = unit.get("solver.positionError", "solver.velocityError")

print(f"{steps} steps of {1e3 * STEP} ms, {substeps} sub-steps: {rescued} rescued, {last} by the fallback")
print(f"largest energy error {worst:.1e} J; constraints at the end {position:.1e} m, {velocity:.1e} m/s")
print(f"most iterations of a step: {largest}")
