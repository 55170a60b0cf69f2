"""The short summary at the end of a run."""

from collections.abc import Mapping

import numpy as np

from fivebar import motors, singularities
from fivebar.drive import Run
from fivebar.scene import Scene
from fivebar.singularities import Event
from fivebar.tip_scenes import Tip
from fivebar.variables import Value

STANDARD_GRAVITY = 9.81
"""Gravity for the scale of energy if the scene has none, m/s2."""

CLOSE = 1e-3
"""Distance between two tips below which two runs agree, m."""

WIDTH = 28


def energy_scale(run: Run) -> float:
    """mgL in J: mass and length of the left proximal link."""
    p = run.parameters
    g = p["gravity.g"] if _has_gravity(run) else STANDARD_GRAVITY
    return p["link[1].mass"] * g * p["link[1].length"]


def energy_note(run: Run) -> str:
    """Note on a value in mgL: the assumed g if there is no gravity, otherwise ""."""
    return "" if _has_gravity(run) else f"g = {STANDARD_GRAVITY:g} m/s2"


def sampling(run: Run) -> str:
    """Note on the sampling behind counts and extreme values of a run."""
    return f"seen at communication points, every {1e3 * run.step_size:g} ms"


def lines(run: Run, events: list[Event]) -> list[str]:
    """The summary of one run, one aligned line per fact."""
    end = run.time[-1]
    steps, substeps, iterations, rejected = (
        int(run[f"solver.{counter}"][-1]) for counter in ("steps", "substeps", "iterations", "rejected")
    )
    facts = [
        ("tip at the end", f"x = {run['tip.x'][-1]:.9f} m, y = {run['tip.y'][-1]:.9f} m (t = {end:g} s)"),
        ("solver", f"{steps} steps, {substeps} sub-steps, {iterations} iterations, {rejected} rejected"),
    ]
    if run.call_seconds:
        facts += [
            ("wall time", f"{run.step_seconds:.2f} s in fmi2DoStep, {run.wall_seconds:.2f} s with outputs read"),
            (
                "real-time factor",
                f"{_factor(end, run.step_seconds)} in fmi2DoStep, {_factor(end, run.wall_seconds)} in all",
            ),
        ]
    facts += [("warning", text) for text in run.warnings or []]
    if run.failure is not None:
        facts.append(("ended early", f"after t = {end:g} s of {run.stop_time:g} s: {run.failure}"))
    return (
        [_line(2, *fact) for fact in facts] + [f"  {sampling(run)}:"] + [_line(4, *fact) for fact in _seen(run, events)]
    )


def motor_lines(run: Run, values: Mapping[str, Value], tip: Tip | None) -> list[str]:
    """Lines on the motors, possibly none; arguments as for `motors.facts`."""
    found = [_line(4, *fact) for fact in motors.facts(run, values, tip)]
    return [f"  motors, {sampling(run)}:", *found] if found else []


def assumed(scene: Scene) -> list[str]:
    """Lines on assumed settings."""
    return [_line(2, what, note) for what, note in scene.assumed.items()]


def servo_note(run: Run, values: Mapping[str, Value]) -> list[str]:
    """A line on the first servo references that cannot close the loop, or none; `values` are the scene's start values."""
    given = run.parameters
    if not given["servo.enabled"] or not all(given[f"servo.kp[{i}]"] for i in (1, 2)):
        return []
    references = [
        np.broadcast_to(run.columns.get(name, values.get(name, 0.0)), run.time.shape)
        for name in ("servo.theta[1]", "servo.theta[2]")
    ]
    _, near, far, _ = (lengths := [float(given[f"link[{i}].length"]) for i in (1, 2, 3, 4)])
    apart = np.abs(
        float(given["base.distance"])
        + lengths[3] * np.exp(1j * references[1])
        - lengths[0] * np.exp(1j * references[0])
    )
    open_ = np.flatnonzero((apart > (near + far) * (1 + 1e-9)) | (apart < abs(near - far) * (1 - 1e-9)))
    if not len(open_):
        return []
    row = int(open_[0])
    text = (
        f"servo.theta = ({references[0][row]:.4g}, {references[1][row]:.4g}) rad at t = {run.time[row]:g} s cannot be reached: the elbows would be {apart[row]:.4g} m "
        f"apart, link[2].length and link[3].length allow {abs(near - far):.4g} to {near + far:.4g} m"
    )
    return [_line(2, "note", text)]


def difference(run: Run, other: Run) -> str:
    """How long the tip of an overlay agrees with the tip of the scene's own run, and the largest distance."""
    distance = tip_distance(run, other)
    apart = np.flatnonzero(distance >= CLOSE)
    # The last communication point before the tips diverge for the first time.
    together = int(apart[0]) - 1 if len(apart) else len(distance) - 1
    limit = f"{1e3 * CLOSE:g} mm"
    close = f"below {limit} up to t = {run.time[together]:g} s" if together >= 0 else f"{limit} or more from the start"
    largest = int(np.argmax(distance))
    text = f"distance of the tips {close}, largest {distance[largest]:.2e} m at t = {run.time[largest]:g} s"
    return _line(2, f"against {run.label}", text)


def tip_distance(run: Run, other: Run) -> np.ndarray:
    """Distance of the tips, m, at the communication points that both runs reached."""
    n = min(len(run.time), len(other.time))
    distance: np.ndarray = np.hypot(run["tip.x"][:n] - other["tip.x"][:n], run["tip.y"][:n] - other["tip.y"][:n])
    return distance


def _seen(run: Run, events: list[Event]) -> list[tuple[str, str]]:
    """Observations at the communication points."""
    energy = float(np.max(np.abs(run["energy.error"])))
    note = f" ({energy_note(run)})" if energy_note(run) else ""
    weakest = int(np.argmin(run["singular.sigmaPhi"]))
    position, velocity = (float(np.max(run[f"solver.{level}Error"])) for level in ("position", "velocity"))
    return [
        ("largest energy error", f"{energy:.2e} J = {energy / energy_scale(run):.2e} mgL{note}"),
        ("constraint violation", f"position {position:.1e} m, velocity {velocity:.1e} m/s"),
        (
            "smallest singular value",
            f"{run['singular.sigmaPhi'][weakest]:.4g} of Phi_q at t = {run.time[weakest]:.3f} s",
        ),
        ("singularities met", singularities.count(events)),
    ]


def _line(indent: int, name: str, text: str) -> str:
    """A line with `text` in a fixed column, whatever the indent."""
    return f"{'':<{indent}}{name:<{WIDTH + 2 - indent}}{text}"


def _has_gravity(run: Run) -> bool:
    return bool(run.parameters["gravity.enabled"]) and run.parameters["gravity.g"] > 0


def _factor(simulated: float, wall: float) -> str:
    return f"{simulated / wall:.0f}" if wall > 0 and simulated > 0 else "-"
