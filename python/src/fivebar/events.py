"""Table of the events of a run at its communication points: singularities, stops, contact with the plane, stick and slip."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fivebar.drawing import plane
from fivebar.drive import Run
from fivebar.singularities import Event

STILL = 1e-9
"""Largest rate, rad/s and m/s, that counts as sticking: round-off leaves 1e-11, and slip exceeds it in a fraction of a step."""

JOINTS = ("left base joint", "left elbow", "tip joint", "right elbow", "right base joint")

STICK = 2
"""Number of the set-valued item of friction.law and contact.law."""


class Row(NamedTuple):
    """An event of a run."""

    time: float
    """Time of the first communication point that shows the event, s; interpolated for a singularity."""

    event: str
    """`direct`, `inverse`, `combined` or `constraint` (singularities), `stop reached`, `stop left`, `plane touched`, `plane left`,
    `sticks` or `slips`."""

    where: str


def find(run: Run, met: list[Event]) -> list[Row]:
    """All events of a run, sorted by time; `met` are its singularities."""
    rows = [Row(event.time, event.kind, str(event).removeprefix(f"{event.kind} singularity ")) for event in met]
    return sorted([*rows, *stops(run), *_plane(run), *_friction(run)], key=lambda row: row.time)


def stops(run: Run) -> list[Row]:
    if not run.parameters["stop.enabled"]:
        return []
    rows = []
    for i, side in ((1, "left"), (2, "right")):
        angle = run[f"theta[{i}]"]
        for bound, beyond in (
            (lower := f"stop.lower[{i}]", angle < value(run, lower)),
            (upper := f"stop.upper[{i}]", angle > value(run, upper)),
        ):
            rows += _changes(run, beyond, "stop reached", "stop left", f"{side} motor, {bound}")
    return rows


def _plane(run: Run) -> list[Row]:
    if not run.parameters["contact.enabled"]:
        return []
    return _changes(run, _touches(run), "plane touched", "plane left", "tip")


def _friction(run: Run) -> list[Row]:
    """Stick and slip of the joints and of the tip on the plane, if the law is set-valued."""
    given, rows = run.parameters, []
    if given["friction.enabled"] and given["friction.law"] == STICK:
        left, right, first, second = (
            run[name] for name in ("omega[1]", "omega[2]", "passive.omega[1]", "passive.omega[2]")
        )
        for i, rate in enumerate((left, first - left, second - first, second - right, right), 1):
            rubs = np.maximum(value(run, f"friction.coulomb[{i}]"), value(run, f"friction.breakaway[{i}]")) > 0
            rows += _changes(run, rubs & (np.abs(rate) <= STILL), "sticks", "slips", JOINTS[i - 1])
    if given["contact.enabled"] and given["contact.law"] == STICK:
        (x, y), _ = plane(run)
        along = np.abs(x * run["tip.vy"] - y * run["tip.vx"])
        moves = _changes(run, _touches(run) & (along <= STILL), "sticks", "slips", "tip on the plane")
        # A tip that leaves the plane does not slip on it.
        leaves = {row.time for row in _plane(run) if row.event == "plane left"}
        rows += [row for row in moves if row.time not in leaves]
    return rows


def _touches(run: Run) -> NDArray[np.bool_]:
    touches: NDArray[np.bool_] = np.hypot(run["contact.fx"], run["contact.fy"]) > 0
    return touches


def value(run: Run, name: str) -> NDArray[np.float64] | float:
    """Value of a parameter: over time if a signal changes it, otherwise constant."""
    return run.columns[name] if name in run.columns else float(run.parameters[name])


def _changes(run: Run, holds: NDArray[np.bool_], begins: str, ends: str, where: str) -> list[Row]:
    """Rows for the beginnings and ends of a condition; it may begin at the first communication point."""
    changes = np.diff(np.concatenate(([False], holds)).astype(np.int8))
    return [Row(float(run.time[row]), begins if changes[row] > 0 else ends, where) for row in np.flatnonzero(changes)]
