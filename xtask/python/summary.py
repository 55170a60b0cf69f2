"""The short summary at the end of a run."""

import numpy as np

import singularities
from drive import Run
from singularities import Event

STANDARD_GRAVITY = 9.81  # m/s2, the scale of energy where the scene has no gravity
WIDTH = 26


def energy_scale(run: Run) -> float:
    """mgL in J: mass and length of the left proximal link."""
    p = run.parameters
    g = p["gravity.g"] if p["gravity.enabled"] and p["gravity.g"] > 0 else STANDARD_GRAVITY
    return p["link[1].mass"] * g * p["link[1].length"]


def lines(run: Run, events: list[Event]) -> list[str]:
    """The summary of one run, one aligned line per fact."""
    end = run.time[-1]
    drift = float(np.max(np.abs(run["energy.error"])))
    weakest = int(np.argmin(run["singular.sigmaPhi"]))
    position, velocity = (float(np.max(run[f"solver.{level}Error"])) for level in ("position", "velocity"))
    steps, substeps, iterations, rejected = (
        int(run[f"solver.{counter}"][-1]) for counter in ("steps", "substeps", "iterations", "rejected")
    )
    facts = [
        ("tip at the end", f"x = {run['tip.x'][-1]:.9f} m, y = {run['tip.y'][-1]:.9f} m (t = {end:g} s)"),
        ("energy drift", f"{drift:.2e} J = {drift / energy_scale(run):.2e} mgL"),
        ("constraint violation", f"position {position:.1e} m, velocity {velocity:.1e} m/s"),
        ("smallest singular value", f"{run['singular.sigmaPhi'][weakest]:.4g} of Phi_q at t = {run.time[weakest]:.3f} s"),
        ("singularities met", singularities.count(events)),
        ("solver", f"{steps} steps, {substeps} sub-steps, {iterations} iterations, {rejected} rejected"),
        ("wall time", f"{run.step_seconds:.2f} s in fmi2DoStep, {run.wall_seconds:.2f} s with all outputs read"),
        ("real-time factor", f"{_factor(end, run.step_seconds)} in fmi2DoStep, {_factor(end, run.wall_seconds)} in all"),
    ]
    facts += [("warning", text) for text in run.warnings or []]
    if run.failure is not None:
        facts.append(("ended early", f"after t = {end:g} s of {run.stop_time:g} s: {run.failure}"))
    return [f"  {name:<{WIDTH}}{text}" for name, text in facts]


def difference(run: Run, other: Run) -> str:
    """How far the tip of an overlay is from that of the scene's own run."""
    distance = tip_distance(run, other)
    end = float(run.time[len(distance) - 1])
    text = f"{distance[-1]:.2e} m between the tips at t = {end:g} s, {np.max(distance):.2e} m at most"
    return f"  {'against ' + run.label:<{WIDTH}}{text}"


def tip_distance(run: Run, other: Run) -> np.ndarray:
    """|dQ| in m at the communication points that both runs reached."""
    n = min(len(run.time), len(other.time))
    return np.hypot(run["tip.x"][:n] - other["tip.x"][:n], run["tip.y"][:n] - other["tip.y"][:n])


def _factor(simulated: float, wall: float) -> str:
    return f"{simulated / wall:.0f}" if wall > 0 and simulated > 0 else "-"
