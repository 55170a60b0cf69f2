"""Figures of the cost of single steps, the cost of effects, the paper, and peers."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from fivebar.pictures import FAINT, RUN_COLOURS
from peers import ahead
from report.figures import COLOURS, SHAPES, logarithmic
from report.tables import Row

SETTING_COLOURS = {
    "i3alp, default tolerance": COLOURS["i3alp, adaptive"],
    "i3alp, fixed 1 ms": COLOURS["i3alp, fixed step"],
    "i3alpConserving, 1 ms": COLOURS["i3alpConserving"],
    "dop853, 1e-8 rad": COLOURS["dop853"],
    "rk4, 1 ms": COLOURS["rk4"],
}
"""The settings of steps.csv."""


BINS = 10 ** (np.arange(81) / 10) / 1e3
"""Bins of step-times.csv: ten per decade from 1 ns, in µs."""


def step_times(rows: list[Row]) -> Figure:
    """Share of calls that take longer than a given time."""
    figure, panels = plt.subplots(1, 2, figsize=(10.6, 4.2), sharey=True)
    columns = (
        ("best [us]", "the method: best of the repeats"),
        ("first [us]", "the machine: one run, whatever else it did"),
    )
    for axes, (column, title) in zip(panels, columns):
        for name, colour in SETTING_COLOURS.items():
            times = np.sort([float(row[column]) for row in rows if row["setting"] == name])
            if len(times):
                longer = 1 - np.arange(len(times)) / len(times)
                axes.step(
                    times,
                    longer,
                    where="post",
                    color=colour,
                    label=f"{name}: p50 {_at(times, 50)}, p99 {_at(times, 99)} µs",
                )
        logarithmic(axes, xlabel="µs per call of 1 ms", title=title)
        axes.legend(loc="lower left", fontsize=8)
    panels[0].set_ylim(bottom=3e-6)  # room for the legends
    panels[0].set_ylabel("share of the calls that take longer")
    return figure


def histogram(rows: list[Row]) -> Figure:
    """Histogram of times of fixed steps, each timed alone."""
    figure, axes = plt.subplots(figsize=(8.4, 4.2))
    settings = list(dict.fromkeys((row["step [s]"], row["solver.maxWork"]) for row in rows))
    for (step, work), colour in zip(settings, RUN_COLOURS):
        own = [row for row in rows if (row["step [s]"], row["solver.maxWork"]) == (step, work)]
        ends, counts = (np.array([float(row[name]) for row in own]) for name in ("up to [ns]", "steps"))
        label = f"h = {1e3 * float(step):g} ms, solver.maxWork = {work}: {counts.sum():.0e} steps".replace("e+0", "e")
        axes.hist(
            ends / 10**0.05 / 1e3, bins=BINS, weights=counts, histtype="step", color=colour, linewidth=1.5, label=label
        )
    logarithmic(axes, xlabel="µs per step", ylabel="steps, per tenth of a decade")
    axes.set_xlim(left=0.1)
    axes.legend(loc="upper right", fontsize=8.5)
    return figure


def near_singularities(rows: list[Row]) -> Figure:
    """Sub-steps and iterations of each call against the smallest singular values."""
    figure, panels = plt.subplots(2, 3, figsize=(11.2, 6.2), sharex="col", sharey="row")
    sigmas = (
        ("sigmaPhi", r"$\sigma_{\min}(\Phi_q)$"),
        ("sigmaJx [m]", r"$\sigma_{\min}(J_x)$  (m)"),
        ("sigmaJq [m2]", r"$\sigma_{\min}(J_q)$  (m²)"),
    )
    for line, count in zip(panels, ("sub-steps", "iterations")):
        for axes, (column, label) in zip(line, sigmas):
            for name in ("i3alp, default tolerance", "dop853, 1e-8 rad"):
                own = [row for row in rows if row["setting"] == name and int(row[count]) > 0]
                axes.plot(
                    [float(row[column]) for row in own], [int(row[count]) for row in own], ".", color=SETTING_COLOURS[name],
                    markersize=2.5, alpha=0.35, label=name, rasterized=True,
                )  # fmt: skip
            logarithmic(axes)
        line[0].set(ylabel=f"{count} per call of 1 ms", ylim=(0.7, 1.5 * max(int(row[count]) for row in rows)))
        line[0].yaxis.set_major_formatter(FuncFormatter(lambda n, _: f"{n:g}"))
    for axes, (_, label) in zip(panels[1], sigmas):
        axes.set_xlabel(label)
    panels[0][0].legend(loc="upper left", markerscale=4, fontsize=8)
    return figure


def prices(rows: list[Row]) -> Figure:
    """Cost of each effect per step: instructions, with ns as text."""
    base = next(row for row in rows if row["case"] == "gravity only")
    others = [row for row in rows if row is not base]
    figure, axes = plt.subplots(figsize=(9.4, 0.9 + 0.36 * len(others)))
    values = [float(row["ratio"]) for row in others]
    places = np.arange(len(others))
    axes.barh(places, values, color=RUN_COLOURS[0], height=0.62)
    for place, row, value in zip(places, others, values):
        axes.text(value, place, f"  {value:.2f} ×,  {float(row['ns']):.0f} ns", va="center", fontsize=8.5)
    axes.axvline(1, color=FAINT, linestyle="--", linewidth=1)
    axes.set_yticks(places, [row["case"] for row in others])
    axes.invert_yaxis()
    axes.grid(False, axis="y")
    axes.set(
        xlim=(0, 1.3 * max(values)),
        xlabel=f"instructions per step, relative to gravity only ({float(base['instructions']):,.0f}; {float(base['ns']):.0f} ns)",
    )
    return figure


def paper(curves: dict[str, np.ndarray], figures: tuple[str, str]) -> Figure:
    """Position of the tip over time; `curves` contains time, x, y by label, the scene's own run first."""
    figure, panels = plt.subplots(2, 1, sharex=True, figsize=(10.6, 5.4))
    for row, (axes, name) in enumerate(zip(panels, figures), start=1):
        for i, (label, curve) in reversed(list(enumerate(curves.items()))):
            broad = {"linewidth": 3.2, "alpha": 0.5} if i else {"linewidth": 1.1}
            axes.plot(curve[:, 0], curve[:, row], color=RUN_COLOURS[i % len(RUN_COLOURS)], label=label, **broad)
        axes.set(ylabel=f"tip {'xy'[row - 1]}  (m)", title=name)
    panels[1].set(xlabel="time  (s)", xlim=(0, max(curve[-1, 0] for curve in curves.values())))
    _legend_above(panels[0], len(curves))
    return figure


def peers(rows: list[Row]) -> Figure:
    """Error after 1 s against time, a panel per scene; our own methods, measured in the same run, are highlighted."""
    figure, panels = plt.subplots(1, len(ahead.SCENES), figsize=(11.2, 5.6), sharey=True)
    rows = [row for row in rows if row["error_1s_m"]]
    names = list(dict.fromkeys(row["peer"] for row in rows))
    others = [name for name in names if name.removeprefix(ahead.OURS) not in COLOURS]
    colours = dict(zip(others, plt.get_cmap("tab10").colors))
    handles = {}
    for axes, scene in zip(panels, ahead.SCENES):
        for name in names:
            own = [row for row in rows if row["peer"] == name and row["scene"] == scene]
            points = [(number(row["ms_per_simulated_second"]), number(row["error_1s_m"])) for row in own]
            # A tip error larger than a link is meaningless.
            points = sorted(point for point in points if 0 < point[1] < 0.21)
            method = name.removeprefix(ahead.OURS)
            colour, marker = (colours[name], "x") if name in colours else (COLOURS[method], SHAPES[method])
            [handles[name]] = axes.plot(
                [p[0] for p in points], [p[1] for p in points], marker=marker, color=colour, linestyle="", markersize=5
            )
        logarithmic(axes, xlabel="ms per simulated second, one core", title=scene)
    panels[0].set_ylabel("error of the tip after 1 s  (m)")
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=6, fontsize=8)
    return figure


def number(cell: str) -> float:
    """A number from a cell that may be empty or a word."""
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _at(times: np.ndarray, percent: float) -> str:
    return f"{np.percentile(times, percent):.2g}"


def _legend_above(axes: Axes, count: int) -> None:
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], ncols=count, loc="lower right", bbox_to_anchor=(1, 1.0), borderaxespad=0.2)
