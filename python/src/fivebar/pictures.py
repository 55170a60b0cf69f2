"""The pictures of a scene, one function each. Each shows the scene's own run and, if useful, its overlays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fivebar import effect_pictures
from fivebar.colours import KIND_COLOURS, LEFT, RIGHT, TIP
from fivebar.drawing import (
    FAINT,
    INK,
    RUN_COLOURS,
    STYLE,
    drawing_order,
    extent,
    full_decades,
    label_decades,
    laid_out,
    legend_above,
    legend_below,
    logarithmic,
    ordered_legend,
    panels,
    positive,
    run_label,
    run_style,
    surroundings,
    thinned,
    time_axis,
)  # fmt: skip
from fivebar.drive import Run
from fivebar.scene import Scene
from fivebar.singularities import GRAVE, KINDS, Event
from fivebar.summary import CLOSE, energy_note, energy_scale, sampling, tip_distance

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fivebar.plot import Plot

KINETIC, POTENTIAL, TOTAL, INPUT, DISSIPATED = "#1864ab", "#e8590c", "#343a40", "#2b8a3e", "#862e9c"

LONGEST_SVG = 5.0
"""Longest run, s, with a path as SVG too: longer ones would take megabytes."""

LEAST_ENERGY = 1e-16
"""Lower end of the axis of the balance residual, J: smaller values are round-off."""

POSES = 11
"""Number of stroboscopic poses."""

POSE_WINDOW = 0.75
"""Longest time, s, that the stroboscopic poses cover: about half a swing of the paper's mechanism."""


TIME_COLOURS = 256
"""Number of colours along the path of the tip: `viridis` has as many."""


def draw_all(begin: Callable[[str], Path], scene: Scene, runs: list[Run], events: list[Event]) -> None:
    """Draws every picture; `begin` returns the path of the next file to write."""
    import matplotlib

    with matplotlib.rc_context(STYLE):
        for name, picture in PICTURES.items():
            if not picture.wanted(scene, runs):
                continue
            png = begin(f"{name}.png")
            figure = picture.draw(scene, runs, events)
            with laid_out(figure):
                # Crop the empty bands that equal scales on both axes leave in the figure.
                crop: dict[str, Any] = {"bbox_inches": figure.get_tightbbox().padded(0.1)} if name == "path" else {}
                figure.savefig(png, **crop)
                if name == "path" and runs[0].time[-1] <= LONGEST_SVG:
                    figure.savefig(begin(f"{name}.svg"), metadata={"Date": None}, **crop)


def path(scene: Scene, runs: list[Run], events: list[Event]) -> "Plot":
    """Picture of poses and of the tip's path."""
    import matplotlib

    with matplotlib.rc_context(STYLE):
        return _path(scene, runs, events)


def curves(run: Run, names: Sequence[str]) -> "Plot":
    """Columns over time; columns with the same unit share axes."""
    import matplotlib

    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(run.units[name], []).append(name)
    with matplotlib.rc_context(STYLE):
        figure, grid = panels(len(groups), figsize=(10, 1 + 2.3 * len(groups)), sharex=True, squeeze=False)
        rows = grid[:, 0]
        for axes, (unit, group) in zip(rows, groups.items()):
            for i, name in enumerate(group):
                axes.plot(*thinned(run.time, run[name]), color=RUN_COLOURS[i % len(RUN_COLOURS)], label=name)
            axes.set_ylabel(f"({unit})" if len(group) > 1 else f"{group[0]}  ({unit})")
            legend_above(axes)
        time_axis(rows[-1], [run])
    return figure


def _tip(scene: Scene, runs: list[Run], _events: list[Event]) -> "Figure":
    figure, (top, bottom) = panels(2, sharex=True, figsize=(10, 5.6))
    for axes, name in ((top, "x"), (bottom, "y")):
        for i, run in drawing_order(runs):
            time, value = thinned(run.time, run[f"tip.{name}"])
            axes.plot(time, value, color=RUN_COLOURS[i % 5], label=run_label(run), **run_style(i))
        axes.set_ylabel(f"tip {name}  (m)")
    top.set_title(f"{scene.name}: position of the tip")
    time_axis(bottom, runs)
    if len(runs) > 1:
        ordered_legend(top, len(runs))
    return figure


def _path(scene: Scene, runs: list[Run], _events: list[Event]) -> "Plot":
    run = runs[0]
    until = min(float(run.time[0]) + POSE_WINDOW, float(run.time[-1]))
    x_limits, y_limits = extent(run, "x"), extent(run, "y")
    # Two panels of 4.4 in with equal scales on both axes, and room for titles and labels.
    height = 4.4 * (y_limits[1] - y_limits[0]) / (x_limits[1] - x_limits[0]) + 1.0
    figure, (left, right) = panels(1, 2, figsize=(10, min(max(height, 3), 8)), sharex=True, sharey=True)
    _poses(left, run, until)
    left.set_title(f"{scene.name}: poses up to {until:g} s")
    if len(runs) == 1:
        _path_over_time(figure, right, run)
    else:
        for i, other in drawing_order(runs):
            right.plot(other["tip.x"], other["tip.y"], color=RUN_COLOURS[i % 5], label=run_label(other), **run_style(i))
        handles, labels = right.get_legend_handles_labels()
        figure.legend(handles[::-1], labels[::-1], ncols=len(runs), loc="outside lower right")
    right.set_title(f"Path of the tip up to {run.time[-1]:g} s")
    for axes in (left, right):
        surroundings(axes, run)
        axes.set(xlim=x_limits, ylim=y_limits)
        axes.set_aspect("equal", adjustable="box")
        axes.set_xlabel("x  (m)")
    left.set_ylabel("y  (m)")
    return figure


def _energy(scene: Scene, runs: list[Run], _events: list[Event]) -> "Figure":
    figure, (top, bottom) = panels(2, sharex=True, figsize=(10, 6), height_ratios=(3, 2))
    run = runs[0]
    curves = [
        ("kinetic", run["energy.kinetic"], KINETIC, "-"),
        ("potential", run["energy.potential"], POTENTIAL, "-"),
        ("kinetic + potential", run["energy.kinetic"] + run["energy.potential"], TOTAL, "--"),
        ("work put in", run["energy.input"], INPUT, (0, (4, 4))),
        ("dissipated", run["energy.dissipated"], DISSIPATED, "-"),
    ]
    if not np.any(run["energy.potential"]):
        del curves[2]
    for name, energy, colour, style in curves:
        if np.any(energy):
            time, value = thinned(run.time, energy)
            top.plot(time, 1e3 * value, color=colour, label=name, linewidth=1.3, linestyle=style)
    low, high = min(top.get_ylim()[0], 0.0), top.get_ylim()[1]
    top.set_ylim(low, high + 0.05 * (high - low))  # a constant energy would lie on the upper edge
    top.set_ylabel("energy  (mJ)")
    top.set_title(f"{scene.name}: energies")
    legend_above(top, 5)
    scale = energy_scale(run)
    logarithmic(bottom)
    for i, other in drawing_order(runs):
        time, residual = thinned(other.time, np.abs(other["energy.error"]))
        bottom.plot(time, positive(residual), color=RUN_COLOURS[i % 5], label=run_label(other), linewidth=1.1)
    bottom.set_ylim(bottom=max(bottom.get_ylim()[0], LEAST_ENERGY))
    bottom.set_ylabel("|balance residual|  (J)")
    in_scale = bottom.secondary_yaxis("right", functions=(lambda e: e / scale, lambda e: e * scale))
    label_decades(in_scale.yaxis)
    in_scale.set_ylabel(f"in mgL, {energy_note(run)}" if energy_note(run) else "in mgL")
    if len(runs) > 1:
        ordered_legend(bottom, len(runs))
    time_axis(bottom, runs)
    return figure


def _constraints(scene: Scene, runs: list[Run], _events: list[Event]) -> "Figure":
    figure, (top, bottom) = panels(2, sharex=True, figsize=(10, 5.2))
    for axes, level, unit, symbol in ((top, "position", "m", r"\Phi"), (bottom, "velocity", "m/s", r"\dot{\Phi}")):
        logarithmic(axes)
        for i, run in drawing_order(runs):
            time, norm = thinned(run.time, run[f"solver.{level}Error"])
            axes.plot(time, positive(norm), color=RUN_COLOURS[i % 5], label=run_label(run), linewidth=1.0)
        axes.set_ylabel(rf"max $|{symbol}|$  ({unit})")
    top.set_title(f"{scene.name}: constraint violation at position and velocity level")
    if len(runs) > 1:
        ordered_legend(top, len(runs))
    time_axis(bottom, runs)
    return figure


def _singularity(scene: Scene, runs: list[Run], events: list[Event]) -> "Figure":
    figure, (*rows, lanes) = panels(4, sharex=True, figsize=(10, 7.6), height_ratios=(3, 3, 3, 1.6))
    run = runs[0]
    signals = (
        ("sigmaJx", r"$\sigma_{\min}(J_x)$", "  (m)"),
        ("sigmaJq", r"$\sigma_{\min}(J_q)$", "  (m²)"),
        ("sigmaPhi", r"$\sigma_{\min}(\Phi_q)$", ""),
    )
    for axes, (name, symbol, unit) in zip(rows, signals):
        time, value = thinned(run.time, run[f"singular.{name}"])
        logarithmic(axes)
        axes.plot(time, positive(value), color=INK, linewidth=0.9)
        axes.set_ylabel(symbol + unit)
        full_decades(axes, value)
    rows[0].set_title(f"{scene.name}: smallest singular values, {sampling(run)}")
    for lane, kind in enumerate(KINDS):
        met = [event.time for event in events if event.kind == kind]
        if not met:
            # A series of unclipped marks without points would make room for a point in the corner of the figure.
            continue
        # Combined and constraint singularities are rare: a thin mark would be lost in a run of 50 s.
        width = 2.5 if kind in GRAVE else 1.0
        lanes.plot(
            met,
            np.full(len(met), lane),
            "|",
            color=KIND_COLOURS[kind],
            markersize=12,
            markeredgewidth=width,
            clip_on=False,
        )
    lanes.set_yticks(range(len(KINDS)), [f"{kind}  {sum(e.kind == kind for e in events)}" for kind in KINDS])
    for label, kind in zip(lanes.get_yticklabels(), KINDS):
        label.set_color(KIND_COLOURS[kind])
    lanes.set_ylim(len(KINDS) - 0.4, -0.6)
    lanes.set_title("Singularities met")
    time_axis(lanes, runs)
    return figure


def _substeps(scene: Scene, runs: list[Run], _events: list[Event]) -> "Figure":
    from matplotlib.ticker import FuncFormatter

    figure, axes = panels(1, figsize=(10, 3.4))
    run = runs[0]
    macro, sub = np.diff(run["solver.steps"]), np.diff(run["solver.substeps"])
    per_step = sub / np.maximum(macro, 1)
    time, value = thinned(run.time[1:], per_step)
    axes.plot(time, np.maximum(value, 1), color=RUN_COLOURS[0], linewidth=0.8, drawstyle="steps-pre")
    axes.set_yscale("log", base=2)
    mean = float(np.mean(per_step)) if len(per_step) else 1.0
    axes.axhline(mean, color=RUN_COLOURS[1], linewidth=1.0, linestyle="--", label=f"mean {mean:.3g}")
    legend_above(axes)
    axes.set_ylabel("sub-steps per macro step")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda n, _: f"{n:g}"))
    axes.set_title(f"{scene.name}: sub-steps per macro step of {1e3 * run.parameters['solver.stepSize']:g} ms")
    time_axis(axes, runs[:1])
    return figure


def _difference(scene: Scene, runs: list[Run], _events: list[Event]) -> "Figure":
    figure, axes = panels(1, figsize=(10, 4))
    logarithmic(axes)
    for i, other in enumerate(runs[1:], start=1):
        distance = tip_distance(runs[0], other)
        time, value = thinned(runs[0].time[: len(distance)], distance)
        axes.plot(time, positive(value), color=RUN_COLOURS[i % 5], label=f"{run_label(other)} against {runs[0].label}")
    axes.axhline(CLOSE, color=FAINT, linewidth=1, linestyle="--")
    axes.set_ylim(bottom=max(axes.get_ylim()[0], 1e-16))
    axes.set_ylabel("|ΔQ|  (m)")
    axes.set_title(f"{scene.name}: distance between the tips")
    legend_below(axes)
    time_axis(axes, runs)
    return figure


def _poses(axes: "Axes", run: Run, until: float) -> None:
    """Draws stroboscopic poses up to a time, s: pale at the start, strong at the end."""
    last = int(np.searchsorted(run.time, until * (1 + 1e-9), side="right")) - 1
    chosen = np.unique(np.linspace(0, last, POSES).round().astype(int))
    base = run.parameters["base.distance"]
    for n, i in enumerate(chosen):
        tip = (run["tip.x"][i], run["tip.y"][i])
        strength = 0.18 + 0.82 * (n / max(len(chosen) - 1, 1)) ** 1.5
        for leg, foot, colour in ((1, 0.0, LEFT), (2, base, RIGHT)):
            elbow = (run[f"elbow[{leg}].x"][i], run[f"elbow[{leg}].y"][i])
            axes.plot(
                [foot, elbow[0], tip[0]],
                [0, elbow[1], tip[1]],
                "-o",
                color=colour,
                alpha=strength,
                linewidth=1.6,
                markersize=2.6,
            )
    axes.plot(run["tip.x"][: last + 1], run["tip.y"][: last + 1], color=TIP, linewidth=1.2, zorder=5)
    axes.plot(*tip, "o", color=TIP, markersize=5, zorder=8)


def _path_over_time(figure: "Figure", axes: "Axes", run: Run) -> None:
    """Draws the tip's path; its colour is the time."""
    from matplotlib.collections import LineCollection

    stride = max(1, len(run.time) // 20000)
    time, points = run.time[::stride], np.column_stack((run["tip.x"], run["tip.y"]))[::stride]
    # One line per colour of the map, and each begins where the last one ends.
    ends = np.unique(np.linspace(0, len(time) - 1, TIME_COLOURS + 1).astype(int))
    long = run.time[-1] > 5
    lines = LineCollection(
        [points[a : b + 1] for a, b in pairwise(ends)],
        cmap="viridis",
        linewidths=0.6 if long else 1.4,
        alpha=0.6 if long else 1.0,
    )
    lines.set_array(time[ends[:-1]])
    lines.set_clim(time[0], time[-1])
    axes.add_collection(lines, autolim=True)
    axes.autoscale_view()
    figure.colorbar(lines, ax=axes, label="time  (s)", shrink=0.8, pad=0.02).outline.set_visible(False)


@dataclass(frozen=True)
class Picture:
    """Draws a picture, and tests whether a scene has its subject."""

    draw: Callable[[Scene, list[Run], list[Event]], "Figure"]
    wanted: Callable[[Scene, list[Run]], bool] = lambda _scene, _runs: True


def _active(effect: str) -> Callable[[Scene, list[Run]], bool]:
    return lambda _scene, runs: bool(runs[0].parameters[f"{effect}.enabled"])


PICTURES = {
    "tip": Picture(_tip),
    "path": Picture(_path),
    "inputs": Picture(effect_pictures.inputs, lambda scene, _runs: bool(effect_pictures.loads(scene))),
    "servo": Picture(effect_pictures.servo, _active("servo")),
    "stop": Picture(effect_pictures.stop, _active("stop")),
    "contact": Picture(effect_pictures.contact, _active("contact")),
    "energy": Picture(_energy),
    "constraints": Picture(_constraints),
    "singularity": Picture(_singularity),
    "substeps": Picture(_substeps),
    "difference": Picture(_difference, lambda _scene, runs: len(runs) > 1),
}
"""All pictures by name; a scene gets each picture with a subject in the scene."""

FILES = (*(f"{name}.png" for name in PICTURES), "path.svg")
"""Names of all files that `draw_all` may write."""
