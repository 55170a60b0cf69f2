"""The pictures of a scene, one function each; every one draws the scene's own run and, where it helps, its overlays."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # no display needed; pyplot must come after

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from drive import Run
from scene import Scene
from singularities import GRAVE, KINDS, Event
from summary import CLOSE, energy_note, energy_scale, sampling, tip_distance

RUN_COLOURS = ("#1864ab", "#e8590c", "#2b8a3e", "#862e9c", "#c2255c")
KINETIC, POTENTIAL, TOTAL, INPUT, DISSIPATED = "#1864ab", "#e8590c", "#343a40", "#2b8a3e", "#862e9c"
KIND_COLOURS = {"direct": "#d6336c", "inverse": "#7048e8", "combined": "#0b7285", "constraint": "#a67c00"}
LEFT, RIGHT, TIP, INK, FAINT = "#1864ab", "#2b8a3e", "#e8590c", "#212529", "#adb5bd"

STYLE = {
    "figure.dpi": 120,
    "figure.constrained_layout.use": True,
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": "#868e96",
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e9ecef",
    "xtick.color": "#495057",
    "ytick.color": "#495057",
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "svg.hashsalt": "fivebar",  # the same run gives the same file
}

LONGEST_SVG = 5.0
"""Longest run, s, whose path is also written as SVG, as the README shows it: longer ones would be megabytes."""

POSES = 11
"""Number of stroboscopic poses."""

POSE_WINDOW = 0.75
"""Longest time, s, that the stroboscopic poses cover: about half a swing of the paper's mechanism."""


def draw_all(directory: Path, scene: Scene, runs: list[Run], events: list[Event]) -> list[Path]:
    """Draws every picture into `directory`; the files written."""
    files = []
    with plt.rc_context(STYLE):
        for name, draw in PICTURES.items():
            if name == "difference" and len(runs) == 1:
                continue
            figure = draw(scene, runs, events)
            # Equal scales on both axes leave bands of the figure empty.
            crop = {"bbox_inches": "tight", "pad_inches": 0.1} if name == "path" else {}
            files.append(directory / f"{name}.png")
            figure.savefig(files[-1], **crop)
            if name == "path" and runs[0].time[-1] <= LONGEST_SVG:
                files.append(directory / f"{name}.svg")
                figure.savefig(files[-1], metadata={"Date": None}, **crop)
            plt.close(figure)
    return files


def thinned(time: np.ndarray, *signals: np.ndarray, buckets: int = 2000) -> list[np.ndarray]:
    """Time and signals with at most about 2·buckets points per signal, every bucket's extremes kept."""
    if len(time) <= 2 * buckets:
        return [time, *signals]
    edges = np.linspace(0, len(time), buckets + 1).astype(int)
    kept = {0, len(time) - 1}
    for signal in signals:
        for a, b in pairwise(edges):
            kept.update((a + int(np.argmin(signal[a:b])), a + int(np.argmax(signal[a:b]))))
    index = np.array(sorted(kept))
    return [time[index], *(signal[index] for signal in signals)]


def _tip(scene: Scene, runs: list[Run], _events: list[Event]) -> Figure:
    figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(10, 5.6))
    for axes, name in ((top, "x"), (bottom, "y")):
        for i, run in _drawing_order(runs):
            time, value = thinned(run.time, run[f"tip.{name}"])
            axes.plot(time, value, color=RUN_COLOURS[i % 5], label=_run_label(run), **_run_style(i))
        axes.set_ylabel(f"tip {name}  (m)")
    top.set_title(f"{scene.name}: position of the tip")
    _time_axis(bottom, runs)
    if len(runs) > 1:
        _ordered_legend(top, len(runs))
    return figure


def _path(scene: Scene, runs: list[Run], _events: list[Event]) -> Figure:
    run = runs[0]
    window = min(POSE_WINDOW, float(run.time[-1]))
    x_limits, y_limits = _extent(run, "x"), _extent(run, "y")
    # Two panels of 4.4 in with equal scales on both axes, and room for titles and labels.
    height = 4.4 * (y_limits[1] - y_limits[0]) / (x_limits[1] - x_limits[0]) + 1.0
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, min(max(height, 3), 8)), sharex=True, sharey=True)
    _poses(left, run, window)
    left.set_title(f"{scene.name}: poses up to {window:g} s")
    if len(runs) == 1:
        _path_over_time(figure, right, run)
    else:
        for i, other in _drawing_order(runs):
            right.plot(other["tip.x"], other["tip.y"], color=RUN_COLOURS[i % 5], label=_run_label(other), **_run_style(i))
        handles, labels = right.get_legend_handles_labels()
        right.legend(handles[::-1], labels[::-1], loc="upper right")
    right.set_title(f"Path of the tip up to {run.time[-1]:g} s")
    for axes in (left, right):
        _base(axes, run)
        axes.set(xlim=x_limits, ylim=y_limits)
        axes.set_aspect("equal", adjustable="box")
        axes.set_xlabel("x  (m)")
    left.set_ylabel("y  (m)")
    return figure


def _energy(scene: Scene, runs: list[Run], _events: list[Event]) -> Figure:
    figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(10, 6), height_ratios=(3, 2))
    run = runs[0]
    curves = [
        ("kinetic", run["energy.kinetic"], KINETIC, "-"),
        ("potential", run["energy.potential"], POTENTIAL, "-"),
        ("kinetic + potential", run["energy.kinetic"] + run["energy.potential"], TOTAL, "--"),
        ("work of the inputs", run["energy.input"], INPUT, (0, (4, 4))),
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
    top.set_title(f"{scene.name}: energies and balance residual")
    top.legend(ncols=5, loc="lower right", bbox_to_anchor=(1, 1.0), borderaxespad=0.2)
    scale = energy_scale(run)
    for i, other in _drawing_order(runs):
        time, residual = thinned(other.time, np.abs(other["energy.error"]))
        bottom.semilogy(time, _positive(residual), color=RUN_COLOURS[i % 5], label=_run_label(other), linewidth=1.1)
    bottom.set_ylabel("|balance residual|  (J)")
    in_scale = bottom.secondary_yaxis("right", functions=(lambda e: e / scale, lambda e: e * scale))
    in_scale.set_ylabel(f"in mgL, {energy_note(run)}" if energy_note(run) else "in mgL")
    if len(runs) > 1:
        _ordered_legend(bottom, len(runs))
    _time_axis(bottom, runs)
    return figure


def _constraints(scene: Scene, runs: list[Run], _events: list[Event]) -> Figure:
    figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(10, 5.2))
    for axes, level, unit, symbol in ((top, "position", "m", r"\Phi"), (bottom, "velocity", "m/s", r"\dot{\Phi}")):
        for i, run in _drawing_order(runs):
            time, norm = thinned(run.time, run[f"solver.{level}Error"])
            axes.semilogy(time, _positive(norm), color=RUN_COLOURS[i % 5], label=_run_label(run), linewidth=1.0)
        axes.set_ylabel(rf"max $|{symbol}|$  ({unit})")
    top.set_title(f"{scene.name}: constraint violation at position and velocity level")
    if len(runs) > 1:
        _ordered_legend(top, len(runs))
    _time_axis(bottom, runs)
    return figure


def _singularity(scene: Scene, runs: list[Run], events: list[Event]) -> Figure:
    figure, (*rows, lanes) = plt.subplots(4, 1, sharex=True, figsize=(10, 7.6), height_ratios=(3, 3, 3, 1.6))
    run = runs[0]
    signals = (
        ("sigmaJx", r"$\sigma_{\min}(J_x)$", "  (m)"),
        ("sigmaJq", r"$\sigma_{\min}(J_q)$", "  (m²)"),
        ("sigmaPhi", r"$\sigma_{\min}(\Phi_q)$", ""),
    )
    for axes, (name, symbol, unit) in zip(rows, signals):
        time, value = thinned(run.time, run[f"singular.{name}"])
        axes.semilogy(time, _positive(value), color=INK, linewidth=0.9)
        axes.set_ylabel(symbol + unit)
        _full_decades(axes, value)
    rows[0].set_title(f"{scene.name}: smallest singular values, {sampling(run)}")
    for lane, kind in enumerate(KINDS):
        met = [event.time for event in events if event.kind == kind]
        # The graver kinds are rare: a thin mark among fifty seconds would be lost.
        width = 2.5 if kind in GRAVE else 1.0
        lanes.plot(met, np.full(len(met), lane), "|", color=KIND_COLOURS[kind], markersize=12, markeredgewidth=width, clip_on=False)
    lanes.set_yticks(range(len(KINDS)), [f"{kind}  {sum(e.kind == kind for e in events)}" for kind in KINDS])
    for label, kind in zip(lanes.get_yticklabels(), KINDS):
        label.set_color(KIND_COLOURS[kind])
    lanes.set_ylim(len(KINDS) - 0.4, -0.6)
    lanes.set_title("Singularities met")
    _time_axis(lanes, runs)
    return figure


def _substeps(scene: Scene, runs: list[Run], _events: list[Event]) -> Figure:
    figure, axes = plt.subplots(figsize=(10, 3.4))
    run = runs[0]
    macro, sub = np.diff(run["solver.steps"]), np.diff(run["solver.substeps"])
    per_step = sub / np.maximum(macro, 1)
    time, value = thinned(run.time[1:], per_step)
    axes.plot(time, np.maximum(value, 1), color=RUN_COLOURS[0], linewidth=0.8, drawstyle="steps-pre")
    axes.set_yscale("log", base=2)
    mean = float(np.mean(per_step)) if len(per_step) else 1.0
    axes.axhline(mean, color=RUN_COLOURS[1], linewidth=1.0, linestyle="--", label=f"mean {mean:.3g}")
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1.0), borderaxespad=0.2)
    axes.set_ylabel("sub-steps per macro step")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda n, _: f"{n:g}"))
    axes.set_title(f"{scene.name}: sub-steps per macro step of {1e3 * run.parameters['solver.stepSize']:g} ms")
    _time_axis(axes, runs[:1])
    return figure


def _difference(scene: Scene, runs: list[Run], _events: list[Event]) -> Figure:
    figure, axes = plt.subplots(figsize=(10, 4))
    for i, other in enumerate(runs[1:], start=1):
        distance = tip_distance(runs[0], other)
        time, value = thinned(runs[0].time[: len(distance)], distance)
        axes.semilogy(time, _positive(value), color=RUN_COLOURS[i % 5], label=f"{_run_label(other)} against {runs[0].label}")
    axes.axhline(CLOSE, color=FAINT, linewidth=1, linestyle="--")
    axes.set_ylim(bottom=max(axes.get_ylim()[0], 1e-16))
    axes.set_ylabel("|ΔQ|  (m)")
    axes.set_title(f"{scene.name}: distance between the tips")
    axes.legend(loc="lower right")
    _time_axis(axes, runs)
    return figure


def _extent(run: Run, axis: str) -> tuple[float, float]:
    """Limits along x or y that show the base, the elbows and the tip all the time."""
    feet = np.array([0.0, run.parameters["base.distance"] if axis == "x" else 0.0])
    parts = [feet, run[f"tip.{axis}"], run[f"elbow[1].{axis}"], run[f"elbow[2].{axis}"]]
    low, high = min(float(p.min()) for p in parts), max(float(p.max()) for p in parts)
    margin = 0.05 * max(high - low, 0.1)
    return low - margin, high + margin


def _poses(axes: Axes, run: Run, window: float) -> None:
    """Stroboscopic poses: pale at the start, strong at the end of the window."""
    last = int(np.searchsorted(run.time, window * (1 + 1e-9), side="right")) - 1
    chosen = np.unique(np.linspace(0, last, POSES).round().astype(int))
    base = run.parameters["base.distance"]
    for n, i in enumerate(chosen):
        tip = (run["tip.x"][i], run["tip.y"][i])
        strength = 0.18 + 0.82 * (n / max(len(chosen) - 1, 1)) ** 1.5
        for leg, foot, colour in ((1, 0.0, LEFT), (2, base, RIGHT)):
            elbow = (run[f"elbow[{leg}].x"][i], run[f"elbow[{leg}].y"][i])
            axes.plot(
                [foot, elbow[0], tip[0]], [0, elbow[1], tip[1]], "-o", color=colour, alpha=strength, linewidth=1.6, markersize=2.6
            )
    axes.plot(run["tip.x"][: last + 1], run["tip.y"][: last + 1], color=TIP, linewidth=1.2, zorder=5)
    axes.plot(*tip, "o", color=TIP, markersize=5, zorder=8)


def _path_over_time(figure: Figure, axes: Axes, run: Run) -> None:
    """The tip's path, its colour telling the time."""
    stride = max(1, len(run.time) // 20000)
    points = np.column_stack((run["tip.x"], run["tip.y"]))[::stride]
    segments = np.stack((points[:-1], points[1:]), axis=1)
    long = run.time[-1] > 5
    lines = LineCollection(segments, cmap="viridis", linewidths=0.6 if long else 1.4, alpha=0.6 if long else 1.0)
    lines.set_array(run.time[::stride][:-1])
    axes.add_collection(lines, autolim=True)
    axes.autoscale_view()
    figure.colorbar(lines, ax=axes, label="time  (s)", shrink=0.8, pad=0.02).outline.set_visible(False)


def _full_decades(axes: Axes, values: np.ndarray) -> None:
    """Limits of a logarithmic axis at powers of ten, not below 1e-8, and no labels between them."""
    positive = values[values > 0]
    if len(positive):
        low, high = np.floor(np.log10(max(positive.min() / 2, 1e-8))), np.ceil(np.log10(max(positive.max(), 1e-7)))
        axes.set_ylim(10.0**low, 10.0**high)
    axes.yaxis.set_minor_formatter(NullFormatter())


def _base(axes: Axes, run: Run) -> None:
    base = run.parameters["base.distance"]
    axes.plot([0, base], [0, 0], color=FAINT, linewidth=1, linestyle=":", zorder=1)
    axes.plot([0, base], [0, 0], "^", color=INK, markersize=8, zorder=7)


def _time_axis(axes: Axes, runs: list[Run]) -> None:
    axes.set_xlabel("time  (s)")
    axes.set_xlim(0, max(float(run.time[-1]) for run in runs) or runs[0].step_size)


def _drawing_order(runs: list[Run]) -> list[tuple[int, Run]]:
    """The scene's own run last, on top."""
    return list(enumerate(runs))[::-1]


def _run_style(i: int) -> dict[str, float]:
    """Overlays lie as a broad band under the scene's own thin line, so that both show where they agree."""
    return {"linewidth": 1.2} if i == 0 else {"linewidth": 3.2, "alpha": 0.55}


def _run_label(run: Run) -> str:
    return f"{run.label} (failed at {run.time[-1]:.3g} s)" if run.failed else run.label


def _ordered_legend(axes: Axes, count: int) -> None:
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], ncols=count, loc="lower right", bbox_to_anchor=(1, 1.0), borderaxespad=0.2)


def _positive(values: np.ndarray) -> np.ndarray:
    """An exact zero has no place on a logarithmic axis."""
    return np.where(values > 0, values, np.nan)


PICTURES: dict[str, Callable[[Scene, list[Run], list[Event]], Figure]] = {
    "tip": _tip,
    "path": _path,
    "energy": _energy,
    "constraints": _constraints,
    "singularity": _singularity,
    "substeps": _substeps,
    "difference": _difference,
}
"""All pictures; that of the difference only for a scene with overlays."""

FILES = (*(f"{name}.png" for name in PICTURES), "path.svg")
"""Names of all files that `draw_all` may write."""
