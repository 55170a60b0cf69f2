"""Pictures of the loads and obstacles of a scene: time-varying loads, servos, end stops and the contact plane."""

from typing import TYPE_CHECKING, Any

import numpy as np

from fivebar.colours import LEFT, RIGHT, TIP
from fivebar.drawing import BARRIER, FAINT, INK, legend_above, panels, plane, thinned, time_axis
from fivebar.drive import Run
from fivebar.scene import Scene
from fivebar.singularities import Event

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIDES = ((1, "left", LEFT), (2, "right", RIGHT))


def loads(scene: Scene) -> list[str]:
    """Names of the time-varying motor torques and tip forces."""
    return [name for name in scene.signals if not name.startswith("servo.")]


def inputs(scene: Scene, runs: list[Run], _events: list[Event]) -> "Figure":
    """Torques and forces over time, each in its own axes."""
    run, names = runs[0], loads(scene)
    figure, all_axes = panels(len(names), sharex=True, squeeze=False, figsize=(10, 1.4 + 1.7 * len(names)))
    for axes, name in zip(all_axes[:, 0], names):
        _curve(axes, run, run[name], INK)
        axes.set_ylabel(f"{name}  ({run.units[name]})")
    all_axes[0, 0].set_title(f"{scene.name}: inputs that change with time")
    time_axis(all_axes[-1, 0], [run])
    return figure


def servo(scene: Scene, runs: list[Run], _events: list[Event]) -> "Figure":
    """Motor angles and references, tracking errors and servo torques."""
    figure, (angles, errors, torques) = panels(3, sharex=True, figsize=(10, 7), height_ratios=(3, 2, 2))
    run = runs[0]
    for i, side, colour in SIDES:
        reference = _input(scene, run, f"servo.theta[{i}]")
        _curve(angles, run, np.degrees(reference), colour, linewidth=4.0, alpha=0.3, label=f"{side} reference")
        _curve(angles, run, np.degrees(run[f"theta[{i}]"]), colour, label=f"{side} angle")
        _curve(errors, run, np.degrees(reference - run[f"theta[{i}]"]), colour)
        _curve(torques, run, 1e3 * run[f"servo.torque[{i}]"], colour)
        _limits(torques, 1e3 * run.parameters[f"servo.limit[{i}]"])
    angles.set_ylabel("motor angle  (deg)")
    errors.set_ylabel("reference − angle\n(deg)")
    torques.set_ylabel("servo torque  (mN·m)")
    angles.set_title(f"{scene.name}: servos")
    legend_above(angles)
    time_axis(torques, [run])
    return figure


def stop(scene: Scene, runs: list[Run], _events: list[Event]) -> "Figure":
    """Motor angles between their stops, and their penetration into the stops."""
    figure, (*angles, depth) = panels(3, sharex=True, figsize=(10, 6.4), height_ratios=(3, 3, 2))
    run, p = runs[0], runs[0].parameters
    for axes, (i, side, colour) in zip(angles, SIDES):
        angle, lower, upper = run[f"theta[{i}]"], p[f"stop.lower[{i}]"], p[f"stop.upper[{i}]"]
        _curve(axes, run, np.degrees(angle), colour)
        low, high = min(angle.min(), lower), max(angle.max(), upper)
        margin = 0.06 * (high - low)
        for begin, end in ((low - margin, lower), (upper, high + margin)):
            axes.axhspan(*np.degrees((begin, end)), facecolor=BARRIER, edgecolor=FAINT, hatch="///", zorder=0)
        axes.set_ylim(*np.degrees((low - margin, high + margin)))
        axes.set_ylabel(f"{side} angle  (deg)")
        _curve(depth, run, 1e3 * np.maximum(np.maximum(angle - upper, lower - angle), 0), colour, label=side)
    depth.set_ylabel("depth in a stop\n(mrad)")
    angles[0].set_title(f"{scene.name}: motor angles between their end stops")
    time_axis(depth, [run])
    return figure


def contact(scene: Scene, runs: list[Run], _events: list[Event]) -> "Figure":
    """Distance of the tip from the plane, penetration and contact force."""
    figure, (gap, depth, forces) = panels(3, sharex=True, figsize=(10, 7), height_ratios=(2, 2, 3))
    run = runs[0]
    normal, offset = plane(run)
    distance = normal[0] * run["tip.x"] + normal[1] * run["tip.y"] - offset
    _curve(gap, run, 1e3 * distance, TIP)
    gap.axhline(0, color=FAINT, linewidth=1)
    gap.set_ylabel("tip above plane\n(mm)")
    _curve(depth, run, 1e3 * np.maximum(-distance, 0), TIP)
    depth.set_ylabel("depth in plane\n(mm)")
    force = run["contact.fx"], run["contact.fy"]
    _curve(forces, run, force[0] * normal[0] + force[1] * normal[1], INK, label="normal")
    _curve(forces, run, force[1] * normal[0] - force[0] * normal[1], RIGHT, label="friction, along (−ny, nx)")
    forces.set_ylabel("force on the tip  (N)")
    gap.set_title(f"{scene.name}: contact of the tip with the plane")
    legend_above(forces)
    time_axis(forces, [run])
    return figure


def _input(scene: Scene, run: Run, name: str) -> np.ndarray:
    """An input over time: its signal, or the constant value of the scene."""
    return run[name] if name in scene.signals else np.full(len(run.time), scene.variants[0].values.get(name, 0.0))


def _curve(axes: "Axes", run: Run, values: np.ndarray, colour: str, **style: Any) -> None:
    time, values = thinned(run.time, values)
    axes.plot(time, values, color=colour, **{"linewidth": 1.2} | style)


def _limits(axes: "Axes", limit: float) -> None:
    """Draws lines at plus and minus `limit` if the curves come near it."""
    if max(map(abs, axes.get_ylim())) > limit / 2:
        for value in (-limit, limit):
            axes.axhline(value, color=FAINT, linewidth=1, linestyle="--")
