"""Two units in one co-simulation: an operator moves a leader; a servo-driven follower copies it and feeds back the force of a wall.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/two_units.py
Every millisecond the follower gets the leader's angles and rates as references. The tip of the leader gets a part of the force
of the wall that the follower touches, one step late, as in any co-simulation with units that step at the same time.
"""

from fivebar import Unit

STEP, SCALE = 1e-3, 0.2
"""Communication step, s; share of the wall's force that the operator feels."""

SHARED = {"gravity.enabled": False, "viscous.enabled": True, "init.theta[1]": 1.7, "init.theta[2]": 1.9}
DAMPED = {f"viscous.b[{joint}]": 0.02 for joint in (1, 5)}
"""Damping of the leader's motors by the operator's arm."""

WALL = {
    "contact.enabled": True,
    "contact.nx": -1.0,
    "contact.ny": 0.0,
    "contact.offset": -0.26,
    "contact.k": 2e4,
    "contact.mu": 0.0,
}
"""A wall at x = 0.26 m; the space left of it is free."""

SERVO = {"servo.enabled": True} | {
    f"servo.{name}[{i}]": x for i in (1, 2) for name, x in (("kp", 200.0), ("kd", 2.0), ("limit", 20.0))
}

with Unit(**SHARED, **DAMPED) as leader, Unit(**SHARED, **SERVO, **WALL) as follower:
    follower["servo.theta"] = leader["theta"]
    print("time (s)  leader x (m)  follower x (m)  wall force (N)  apart (mrad)")
    for count in range(1001):
        theta, omega = leader.get("theta", "omega")
        force = follower["contact.fx"]
        if count % 100 == 0:
            apart = max(abs(theta - follower["theta"]))
            x, y = leader["tip.x"], follower["tip.x"]
            print(f"{leader.time:8.1f}  {x:12.4f}  {y:14.4f}  {force:14.3f}  {1e3 * apart:12.2f}")
        # The operator pushes to the right with 0.5 N.
        leader["tip.fx"] = 0.5 + SCALE * force
        follower.update({"servo.theta": theta, "servo.omega": omega})
        leader.step(STEP)
        follower.step(STEP)
