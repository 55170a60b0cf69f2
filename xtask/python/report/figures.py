"""The figures of accuracy against time: one function each, from the measurements."""

import matplotlib

matplotlib.use("Agg")  # no display needed; pyplot must come after

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from fivebar.pictures import FAINT, INK
from report.picks import one_of_each_kind, power
from report.tables import Marker, Reference, Row

COLOURS = {
    "dop853": "#1864ab",
    "i3alp, adaptive": "#e8590c",
    "i3alp, fixed step": "#f59f00",
    "i3alpConserving": "#9c36b5",
    "i3alpPrinted": "#868e96",
    "rk4": "#2b8a3e",
    "automatic": "#c2255c",
}
"""One colour per method, in every figure."""

SHAPES = {
    "dop853": "o",
    "i3alp, adaptive": "s",
    "i3alp, fixed step": "D",
    "i3alpConserving": "P",
    "i3alpPrinted": "v",
    "rk4": "^",
    "automatic": "*",
}

USELESS = 1.0
"""An error, m, above the size of the machine."""

SLOPE_RANGE = (1e-10, 3e-3)
"""Range of errors, m, in which the order of a method is visible: above round-off, below the size of the machine."""


def work_precision(markers: list[Marker], references: list[Reference]) -> Figure:
    """Error against time, a panel per scene, a line per method, settings beside markers."""
    columns = 2 if len(references) == 4 else min(3, len(references))
    rows = -(-len(references) // columns)
    figure, panels = plt.subplots(
        rows, columns, figsize=(4.1 * columns + 0.6, 4.3 * rows + 0.5), squeeze=False, sharey=True
    )
    for axes in panels.flat[len(references) :]:
        axes.set_visible(False)
    for axes, reference in zip(panels.flat, references):
        own = [m for m in markers if m.scene == reference.scene and m.complete and m.error < USELESS]
        for method in COLOURS:
            line = [m for m in own if m.method == method]
            _line(axes, [m.cost for m in line], [m.error for m in line], method)
        if own:
            limits = min(m.cost for m in own) / 1.5, max(m.cost for m in own) * 3
            axes.set_xlim(*limits)
        _own_error(axes, reference, 0.98)
        logarithmic(axes, title=f"{reference.kind}: {reference.scene}")
        axes.set_ylim(1e-15, USELESS)
        axes.set_xlabel("µs per simulated ms, one core")
        top = axes.secondary_xaxis("top", functions=(_inverse, _inverse))
        top.set_xlabel("times real time", fontsize=8, color="#495057")
        top.tick_params(labelsize=7.5, colors="#495057")
        top.minorticks_off()
    for row in panels:
        row[0].set_ylabel("largest error of the tip  (m)")
    _legend(figure, panels[0][0])
    # Positions of panels and markers are known after the layout of everything else.
    figure.draw_without_rendering()
    for axes, reference in zip(panels.flat, references):
        own = [m for m in markers if m.scene == reference.scene and m.complete and m.error < USELESS]
        _notes(axes, own, [text.get_window_extent() for text in axes.texts])
    return figure


MARKER_SIZE = 4.2
"""Width of a marker, points."""

NOTE_SIZE = 7
"""Font size of the settings beside markers, points."""

SIDES = tuple(
    ((distance * x, distance * y), ha, va)
    for distance in (4, 9)
    for (x, ha) in ((1, "left"), (-1, "right"))
    for (y, va) in ((1, "bottom"), (-1, "top"), (0, "center"))
)
"""Places for a label: offset from its marker, points, and alignment of the text."""


ROOM = 1.0
"""Smallest distance of a label from lines, markers and other labels, points."""


def _notes(axes: Axes, markers: list[Marker], taken: list[Bbox]) -> None:
    """Labels the ends of each line and every third marker with its setting, placed so that it covers no line, marker or other label. A label is
    left out if every side is taken, or if the same text is already beside another method's marker."""
    pixels = axes.figure.dpi / 72  # per point
    lines = [
        line.get_transform().transform_path(line.get_path()) for line in axes.get_lines() if len(line.get_xdata()) > 1
    ]
    points = axes.transData.transform([(m.cost, m.error) for m in markers])
    taken = [*taken, *(Bbox([point, point]).padded(pixels * MARKER_SIZE / 2) for point in points)]
    noted: list[tuple[str, np.ndarray]] = []
    # Line ends come first because they are the most informative.
    of_method = [[m for m in markers if m.method == method] for method in COLOURS]
    for m in [
        *(m for line in of_method for m in dict.fromkeys([*line[:1], *line[-1:]])),
        *(m for line in of_method for m in line[3:-2:3]),
    ]:
        point = axes.transData.transform((m.cost, m.error))
        if any(setting == m.setting and np.abs(point - other).max() < pixels * MARKER_SIZE for setting, other in noted):
            continue
        for offset, ha, va in SIDES:
            note = axes.annotate(
                m.setting,
                (m.cost, m.error),
                xytext=offset,
                textcoords="offset points",
                fontsize=NOTE_SIZE,
                color=COLOURS[m.method],
                ha=ha,
                va=va,
            )
            # Labels lie inside the panels; including each in the layout would take seconds.
            note.set_in_layout(False)
            box = note.get_window_extent().padded(pixels * ROOM)
            inside = (
                axes.bbox.x0 <= box.x0 and box.x1 <= axes.bbox.x1 and axes.bbox.y0 <= box.y0 and box.y1 <= axes.bbox.y1
            )
            if (
                inside
                and not any(box.overlaps(other) for other in taken)
                and not any(line.intersects_bbox(box, filled=False) for line in lines)
            ):
                taken.append(box)
                noted.append((m.setting, point))
                break
            note.remove()


def main_picture(markers: list[Marker], references: list[Reference]) -> Figure:
    """Work-precision diagram for one scene of each kind; the picture of docs/accuracy.md."""
    return work_precision(markers, one_of_each_kind(references))


def order(markers: list[Marker], references: list[Reference]) -> Figure:
    """Error against step, with fitted slopes; and error against tolerance."""
    rows = len(references)
    figure, panels = plt.subplots(rows, 2, figsize=(10.6, 3.5 * rows + 0.4), squeeze=False, sharey="row")
    for (left, right), reference in zip(panels, references):
        for axes, knob, label in ((left, "step", "step  (s)"), (right, "tolerance", "tolerance  (rad)")):
            notes = []
            for method in COLOURS:
                line = [
                    m
                    for m in markers
                    if (m.scene, m.method, m.knob) == (reference.scene, method, knob)
                    and m.complete
                    and m.error < USELESS
                ]
                _line(axes, [m.value for m in line], [m.error for m in line], method)
                slope = fitted_slope(line, reference.own_error)
                if np.isfinite(slope):
                    notes.append((method, slope))
            for i, (method, slope) in enumerate(notes):
                axes.text(
                    0.98,
                    0.04 + 0.075 * i,
                    f"slope {slope:.2f}",
                    color=COLOURS[method],
                    fontsize=8.5,
                    ha="right",
                    transform=axes.transAxes,
                )
            _own_error(axes, reference, 0.02)
            logarithmic(axes, xlabel=label, title=f"{reference.kind}: {reference.scene}")
            axes.set_ylim(1e-15, USELESS)
        left.set_ylabel("largest error of the tip  (m)")
    _legend(figure, *panels[0])
    return figure


def fitted_slope(line: list[Marker], own_error: float) -> float:
    """Order: slope of log error over log step, within the range where it is visible; NaN for fewer than three markers."""
    low = max(SLOPE_RANGE[0], 10 * own_error)
    seen = [m for m in line if low < m.error < SLOPE_RANGE[1]]
    if len(seen) < 3:
        return float("nan")
    return float(np.polyfit(np.log([m.value for m in seen]), np.log([m.error for m in seen]), 1)[0])


def energy(rows: list[Row]) -> Figure:
    """Largest energy error of the long fall against time."""
    figure, axes = plt.subplots(figsize=(8.4, 4.4))
    for method in COLOURS:
        line = [row for row in rows if row["method"] == method and row["ending"] == "complete"]
        line = [row for row in line if 0 < float(row["worst |dE| [mgL]"]) < 1e3]
        _line(
            axes,
            [float(row["us per simulated ms"]) for row in line],
            [float(row["worst |dE| [mgL]"]) for row in line],
            method,
        )
    logarithmic(axes, xlabel="µs per simulated ms, one core", ylabel="largest |energy error|  (mgL)")
    axes.legend(loc="upper right")
    return figure


def horizon(rows: list[Row]) -> Figure:
    """Time for which each setting stays within 1 mm of the best run."""
    limit = next((float(row["within 1 mm until [s]"]) for row in rows if row["method"] == "double precision"), None)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.6, 4.2), sharey=True)
    for axes, knob, label in ((left, "tolerance", "tolerance  (rad)"), (right, "step", "step  (s)")):
        for method in COLOURS:
            line = [row for row in rows if row["method"] == method and row["knob"] == knob]
            _line(
                axes,
                [float(row["value"]) for row in line],
                [float(row["within 1 mm until [s]"]) for row in line],
                method,
            )
        if limit is not None:
            axes.axhline(limit, color=FAINT, linestyle="--", linewidth=1)
            axes.annotate(
                "where double precision ends", (0.98, limit), xycoords=("axes fraction", "data"), xytext=(0, 3),
                textcoords="offset points", ha="right", fontsize=8, color="#495057",
            )  # fmt: skip
        axes.set(xscale="log", xlabel=label)
        axes.minorticks_off()
        axes.legend(loc="upper right", bbox_to_anchor=(1, 0.92))
    left.set_ylabel("within 1 mm until  (s)")
    left.set_ylim(bottom=0)
    return figure


def logarithmic(axes: Axes, **properties: object) -> None:
    """Logarithmic scales over many decades, without distracting minor ticks."""
    axes.set(xscale="log", yscale="log", **properties)
    axes.minorticks_off()


def _line(axes: Axes, x: list[float], y: list[float], method: str) -> None:
    if x:
        axes.plot(
            x, y, color=COLOURS[method], marker=SHAPES[method], markersize=MARKER_SIZE, linewidth=1.5, label=method
        )


def _own_error(axes: Axes, reference: Reference, x: float) -> None:
    """Marks the reference's own error, below which it cannot judge; the note is at `x`, 0 to 1, away from the most accurate settings."""
    axes.axhspan(1e-16, reference.own_error, color="#f1f3f5", zorder=0)
    axes.axhline(reference.own_error, color=FAINT, linewidth=0.9, linestyle="--")
    note = axes.annotate(
        f"reference good to {power(reference.own_error)} m", (x, reference.own_error), xycoords=("axes fraction", "data"),
        xytext=(0, 2), textcoords="offset points", fontsize=7, color=INK, alpha=0.75, ha="left" if x < 0.5 else "right",
    )  # fmt: skip
    note.set_in_layout(False)


def _legend(figure: Figure, *panels: Axes) -> None:
    """One legend below all panels, in two lines if there is only one panel's width."""
    found = {label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels())}
    figure.legend(
        found.values(),
        found.keys(),
        loc="outside lower center",
        ncols=len(found) if figure.get_figwidth() > 6 else 3,
        fontsize=9,
    )


def _inverse(cost: np.ndarray) -> np.ndarray:
    """Converts microseconds per simulated millisecond to a multiple of real time, and back."""
    return 1e3 / np.maximum(cost, 1e-12)
