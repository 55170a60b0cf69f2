"""Optimal control by model exchange: CasADi uses the equations of the unit and their derivatives, IPOPT finds a swing-up.

The machine moves from hanging at rest to rest in a raised posture within 1.2 s with the least torque. The torque is limited
to a sixth of the torque that holds this posture, so the machine has to swing up. Multiple shooting: the unknowns are the
states at 25 points and the constant torques between them. Finally, the torques are played back in co-simulation.

Run with `fivebar` installed (in a checkout: `target/venv`): python examples/optimal_control.py
This needs CasADi: pip install casadi. The picture is target/optimal_control.svg.
"""

from pathlib import Path

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import fivebar
from fivebar import Unit

SECONDS, PIECES, SUBSTEPS, MOST = 1.2, 24, 4, 0.01  # MOST: largest torque, N.m
STATES = ("theta[1]", "theta[2]", "omega[1]", "omega[2]")
REST, GOAL = np.array([-1.2598642396, -1.8817284140, 0.0, 0.0]), np.array([-0.3, -1.4, 0.0, 0.0])
START = {"init.theta[1]": REST[0], "init.theta[2]": REST[1], "init.assembly": 2}


def piece(f: ca.Function) -> ca.Function:
    """State after one piece with constant torque, as a function: classical Runge-Kutta method of order 4."""
    start, tau = ca.MX.sym("x", 4), ca.MX.sym("tau", 2)
    rate = lambda x: f(x, ca.vertcat(tau, ca.DM.zeros(6)))[0]
    x, h = start, SECONDS / PIECES / SUBSTEPS
    for _ in range(SUBSTEPS):
        a = rate(x)
        b = rate(x + h / 2 * a)
        c = rate(x + h / 2 * b)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c))
    return ca.Function("piece", [start, tau], [x])


def swing(after: ca.Function) -> tuple[np.ndarray, np.ndarray]:
    """Optimal states and torques. The unit provides first derivatives; IPOPT approximates the Hessian."""
    problem = ca.Opti()
    x, tau = problem.variable(4, PIECES + 1), problem.variable(2, PIECES)
    problem.minimize(1e4 * SECONDS / PIECES * ca.sumsqr(tau))
    for k in range(PIECES):
        problem.subject_to(x[:, k + 1] == after(x[:, k], tau[:, k]))
    problem.subject_to([x[:, 0] == REST, x[:, PIECES] == GOAL, problem.bounded(-MOST, ca.vec(tau), MOST)])
    problem.set_initial(x, np.linspace(REST, GOAL, PIECES + 1).T)
    learning = {"hessian_approximation": "limited-memory", "limited_memory_max_history": 50, "tol": 1e-4}
    problem.solver("ipopt", {"print_time": 0}, learning | {"print_level": 0, "sb": "yes"})
    found = problem.solve()
    return found.value(x), found.value(tau)


def played_back(tau: np.ndarray) -> np.ndarray:
    """States that co-simulation reaches with these torques."""
    with Unit(**START) as unit:
        states = [unit.get(*STATES)]
        for torques in tau.T:
            unit["tau"] = torques
            unit.step(SECONDS / PIECES)
            states.append(unit.get(*STATES))
    return np.array(states).T


if __name__ == "__main__":
    dae = ca.DaeBuilder("five_bar", str(fivebar.unit()))
    [dae.set(name, value) for name, value in START.items()]
    f = dae.create("f", ["x", "u"], ["ode", "y"])
    planned, tau = swing(piece(f))
    states = played_back(tau)
    lifted = f(GOAL, 0)[1][1] - f(REST, 0)[1][1]
    free, left, right = (f(GOAL, u)[0][2:] for u in (0, np.eye(8)[0], np.eye(8)[1]))
    holding = ca.norm_inf(ca.solve(ca.horzcat(left - free, right - free), free))
    largest = abs(tau).max()
    print(f"lifted by {float(lifted):.3f} m; largest torque {largest:.4f} N.m, to hold it {float(holding):.4f} N.m")
    print(f"played back: the goal is missed by {np.degrees(abs(states - planned)[:2, -1].max()):.1e} deg")
    time = np.linspace(0, SECONDS, PIECES + 1)
    figure, (above, below) = plt.subplots(2, sharex=True, figsize=(7, 5), layout="constrained")
    for i, side in enumerate(("left", "right")):
        above.stairs(1e3 * tau[i], time, baseline=None, label=f"{side} motor", color=f"C{i}")
        below.plot(time, np.degrees(planned[i]), label=f"{side}, planned", color=f"C{i}")
        below.plot(time, np.degrees(states[i]), "o", markersize=4, label=f"{side}, played back", color=f"C{i}")
    above.set_ylabel("torque (mN·m)"), above.legend()
    below.set(xlabel="time (s)", ylabel="motor angle (°)"), below.legend(loc="upper center", ncols=2)
    Path("target").mkdir(exist_ok=True)
    figure.savefig("target/optimal_control.svg", metadata={"Date": None})
