"""The motors of a run, for the beginning of the summary: errors of servos, torques, rates, saturation, stops."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fivebar import events
from fivebar.drive import Run
from fivebar.signals import TIP
from fivebar.tip_scenes import Tip
from fivebar.variables import Value

Floats = NDArray[np.float64]

SIDES = ((1, "left"), (2, "right"))

SATURATED = math.tanh(1.0)
"""Torque limit·tanh(u/limit) over the limit, at u = limit: from here on a servo counts as saturated."""


def facts(run: Run, values: Mapping[str, Value], tip: Tip | None) -> list[tuple[str, str]]:
    """Lines for the parts that the scene has, as (name, text); `values` are all start values of the run, `tip` is its part in the tip's coordinates."""
    return [*_tracking(run, values, tip), *_driven(run, values), *_stops(run)]


def _tracking(run: Run, values: Mapping[str, Value], tip: Tip | None) -> list[tuple[str, str]]:
    """Errors of motors with a position gain, and of the tip if it has references."""
    if not run.parameters["servo.enabled"]:
        return []
    found = [
        (f"tracking error, {side}", _sizes(run, _course(run, values, f"servo.theta[{i}]") - run[f"theta[{i}]"], "rad"))
        for i, side in SIDES
        if np.any(events.value(run, f"servo.kp[{i}]"))
    ]
    if tip is not None and tip.signals:
        x, y = (tip.coordinate(name, run.time, rate=False) - run[name] for name in TIP)
        found.append(("tracking error, tip", _sizes(run, 1e3 * np.hypot(x, y), "mm")))
    return found


def _driven(run: Run, values: Mapping[str, Value]) -> list[tuple[str, str]]:
    """Torques of driven motors, rates of both motors, and how long servos are saturated."""
    servo = {(i, side): run[f"servo.torque[{i}]"] for i, side in SIDES}
    torques = {side: own + _course(run, values, f"tau[{i}]") for (i, side), own in servo.items()}
    found = [(f"torque, {side}", _sizes(run, torque, "N.m")) for side, torque in torques.items() if np.any(torque)]
    if found:
        found += [(f"rate, {side}", _sizes(run, run[f"omega[{i}]"], "rad/s")) for i, side in SIDES]
    shares = [
        f"{side} {100 * np.mean(np.abs(own) > SATURATED * events.value(run, f'servo.limit[{i}]')):.1f} %"
        for (i, side), own in servo.items()
        if np.any(own)
    ]
    return [*found, ("servos saturated", f"{', '.join(shares)} of the time")] if shares else found


def _stops(run: Run) -> list[tuple[str, str]]:
    """How often and how far the motors enter their stops, or their least distance from them."""
    reached = [row.where for row in events.stops(run) if row.event == "stop reached"]
    found = []
    for i, side in SIDES if run.parameters["stop.enabled"] else ():
        angle = run[f"theta[{i}]"]
        beyond = np.maximum(
            events.value(run, f"stop.lower[{i}]") - angle, angle - events.value(run, f"stop.upper[{i}]")
        )
        row, times = int(np.argmax(beyond)), sum(where.startswith(side) for where in reached)
        text = (
            f"reached {times} time{'s' if times > 1 else ''}, by up to {beyond[row]:.3g} rad at t = {run.time[row]:g} s"
            if times
            else f"not reached, {-beyond[row]:.3g} rad away at t = {run.time[row]:g} s"
        )
        found.append((f"stops, {side}", text))
    return found


def _course(run: Run, values: Mapping[str, Value], name: str) -> Floats:
    """An input at the communication points."""
    return np.broadcast_to(np.asarray(run.columns.get(name, values[name]), dtype=np.float64), run.time.shape)


def _sizes(run: Run, course: Floats, unit: str) -> str:
    """Root mean square and peak."""
    row = int(np.argmax(np.abs(course)))
    return f"rms {np.sqrt(np.mean(course**2)):.3g}, peak {np.abs(course[row]):.3g} {unit} at t = {run.time[row]:.4g} s"
