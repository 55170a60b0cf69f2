"""Looking ahead: a stored state, 0.5 s of prediction for each of some torques, and back as if nothing had happened.

Where `fivebar` is installed (in a checkout `target/venv`): python examples/look_ahead.py
What a stored state costs: rows `fmi2GetFMUstate` and `fmi2SetFMUstate` of `cargo xtask bench`.
"""

from fivebar import Unit

TORQUES = [0.0, 0.05, 0.1, 0.15]
"""On the left motor, N·m."""


def predicted(twin: Unit, torque: float) -> float:
    """Height of the tip in 0.5 s under a constant torque, m. The twin is left where it was."""
    now = twin.state()
    twin["tau[1]"] = torque
    # One communication step, however long: the unit divides it by itself.
    twin.step(0.5)
    height = twin["tip.y"]
    twin.restore(now)
    return height


# The method automatic chooses its steps by solver.errorTolerance alone: docs/automatic.md.
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
