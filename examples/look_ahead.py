"""Looking ahead: store the state, predict 0.5 s for each of several torques, and return as if nothing had happened.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/look_ahead.py
For the cost of storing a state, see the rows `fmi2GetFMUstate` and `fmi2SetFMUstate` of `cargo xtask bench`.
"""

from fivebar import Unit

TORQUES = [0.0, 0.05, 0.1, 0.15]
"""Candidate torques of the left motor, N·m."""


def predicted(twin: Unit, torque: float) -> float:
    """Height of the tip, m, after 0.5 s of constant torque. The state of the twin does not change."""
    now = twin.state()
    twin["tau[1]"] = torque
    # A single long communication step: the unit divides it into smaller steps.
    twin.step(0.5)
    height = twin["tip.y"]
    twin.restore(now)
    return height


# The method `automatic` chooses its steps only by solver.errorTolerance: see docs/automatic.md.
with Unit(**{"solver.method": "automatic", "init.theta[2]": 2.0944, "viscous.enabled": True}) as twin:
    for _ in range(4):
        heights = {torque: predicted(twin, torque) for torque in TORQUES}
        best = max(heights, key=heights.get)
        print(
            f"at {twin.time:.1f} s: "
            + ", ".join(f"{torque:g} N.m leads to {y:+.4f} m" for torque, y in heights.items())
        )
        print(f"          taken: {best:g} N.m")
        twin["tau[1]"] = best
        twin.step(0.1)
    print(f"tip at {twin.time:.1f} s: y = {twin['tip.y']:+.4f} m")
