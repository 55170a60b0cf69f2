"""Pictures of a drawing: its place in the workspace, commanded and actual path, errors and torques, or the place where it is blocked."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from fivebar.borders import direct_curves, stop_curves
from fivebar.colours import LEFT, RIGHT, TIP
from fivebar.drawing import WRONG, thinned
from fivebar.kinematics import SIDES, Machine, Working, mode_name
from fivebar.paths import Blocked, Limits, Outcome, Plan, strokes_of
from fivebar.scene import Scene
from fivebar.strokes import Drawing, points_of
from fivebar.workspace_pictures import (
    BLACK,
    GREY,
    MM,
    SKY,
    STYLE,
    WHITE,
    chain,
    draw_legs,
    draw_loci,
    hide_outside,
)

Floats = NDArray[np.float64]

WIDTH = 7.2
"""Width of a picture, inches."""

REACHED = "#e9eef3"
COMMANDED = "#9ecae8"
"""Colour of the commanded line, a band below the drawn line."""

BUCKETS = 400
"""Number of time intervals with their extremes in a curve over time."""

SEEN = 1e-6
"""Shortest lifted-pen move that is drawn, m."""

ZOOM = 20.0
"""Width of the enlarged window in multiples of the largest distance off the drawing; it is at least 1/40 of the drawing."""


def draw(outcome: Outcome, name: str, limits: Limits, folder: Path) -> list[Path]:
    """Draws `drawn.svg` and `drawn.png` with the commanded and the actual path of the drawing `name`; returns the files."""
    made = outcome.plan
    with matplotlib.rc_context(STYLE):
        box = made.drawing.box * MM
        window = _window(outcome)
        # A straight line has no height: the box must still contain the enlarged window.
        extent = np.maximum(box[1] - box[0], (window[1] - window[0]) * MM)
        wide = WIDTH - 1.0
        high = float(np.clip(wide * extent[1] / extent[0], 0.8, 6.0))
        heights = [2.75, high, 1.35]
        size = WIDTH, sum(heights) + 3.5
        figure = Figure(figsize=size)

        def place(left: float, from_top: float, width: float, height: float) -> Axes:
            return figure.add_axes(
                (left / size[0], 1 - (from_top + height) / size[1], width / size[0], height / size[1])
            )

        top = 1.0
        whole, near = place(0.75, top, 2.75, heights[0]), place(4.2, top, 2.75, heights[0])
        top += heights[0] + 0.85
        sheet = place(0.75, top, wide, high)
        top += high + 0.85
        error, torque = place(0.75, top, 2.75, heights[2]), place(4.2, top, 2.75, heights[2])
        figure.text(
            0.15 / size[0],
            1 - 0.22 / size[1],
            f"{made.scene.name} draws {name} in working mode {mode_name(made.working)}",
            va="center",
            fontsize=11,
        )
        figure.text(0.15 / size[0], 1 - 0.36 / size[1], _broken(outcome.words(), 110), va="top", fontsize=8, color=GREY)
        _overview(whole, made)
        _sheet(sheet, outcome, window)
        _enlarged(near, outcome, sheet, window)
        _errors(error, outcome)
        _torques(torque, outcome, limits)
        for axes, title in (
            (whole, "a  The drawing within the reach"),
            (near, "b  Where it is farthest off"),
            (sheet, "c  Commanded and done"),
            (error, "d  Errors (mm), pen down in grey"),
            (torque, "e  Torques of the servos (N·m)"),
        ):
            axes.set_title(title, fontsize=9)
        return _save(figure, folder, "drawn")


def draw_blocked(
    scene: Scene, working: Working, drawing: Drawing, blocked: Blocked, name: str, folder: Path
) -> list[Path]:
    """Draws `blocked.svg` and `blocked.png`: the drawing, the borders of the working mode and the place where the machine is blocked."""
    machine = Machine.from_scene(scene)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 5.2))
        whole, near = figure.add_axes((0.1, 0.33, 0.39, 0.5)), figure.add_axes((0.59, 0.33, 0.39, 0.5))
        strokes = [points_of(stroke, 16).reshape(-1, 2) for stroke in drawing.strokes]
        handles: list[Patch | Line2D] = []
        for axes in (whole, near):
            handles = _background(axes, scene, machine, working)
            # One artist for all strokes, since a drawing may have thousands.
            axes.add_collection(
                LineCollection([stroke * MM for stroke in strokes], colors=TIP, linewidths=1.3, zorder=7)
            )
            axes.plot(*(blocked.place * MM), "X", color=WRONG, markeredgecolor=WHITE, markersize=11, zorder=10)
        points = np.concatenate([*strokes, blocked.place[None]])
        _frame(whole, np.concatenate([points, _corners(machine)]), 0.03)
        low, high = points.min(axis=0), points.max(axis=0)
        half = max(0.12 * float(np.max(high - low)), 0.01 * machine.size)
        _frame(near, np.stack([blocked.place - half, blocked.place + half]), 0.0)
        whole.set_title("a  The drawing and what bounds it", fontsize=9)
        near.set_title("b  The place where it is blocked", fontsize=9)
        handles.append(Line2D([], [], color=TIP, linewidth=1.3, label=f"{name}"))
        handles.append(Line2D([], [], color=WRONG, marker="X", markersize=9, linestyle="none", label="blocked here"))
        figure.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 0.0), frameon=False, ncols=1)
        figure.text(0.02, 0.97, _broken(str(blocked)), va="top", fontsize=9)
        return _save(figure, folder, "blocked")


def _broken(sentence: str, most: int = 92) -> str:
    """Breaks a sentence into lines."""
    lines = [""]
    for word in sentence.split():
        lines = [*lines[:-1], f"{lines[-1]} {word}".strip()] if len(lines[-1]) + len(word) < most else [*lines, word]
    return "\n".join(lines)


def _save(figure: Figure, folder: Path, name: str) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{name}.{suffix}" for suffix in ("svg", "png")]
    for file in files:
        figure.savefig(file, dpi=150, metadata={"Date": None} if file.suffix == ".svg" else None)
    return files


def _corners(machine: Machine) -> Floats:
    """Corners of the bounding box of reach and motors, m."""
    (_, left), (_, right) = machine.reach.tolist()
    begin, end = max(-left, machine.distance - right), min(left, machine.distance + right)
    crossing = (machine.distance**2 + left**2 - right**2) / (2 * machine.distance) if machine.distance > 0 else 0.0
    height = (
        min(left, right) if not 0 < crossing < machine.distance else float(np.sqrt(max(left**2 - crossing**2, 0.0)))
    )
    return np.array([(begin, -height), (end, height), *machine.motors])


def _frame(axes: Axes, points: Floats, margin: float) -> None:
    """Sets up axes in mm with equal scales around the points; `margin` is a share of their extent."""
    low, high = points.min(axis=0) * MM, points.max(axis=0) * MM
    place, figure = axes.get_position(), axes.figure
    assert isinstance(figure, Figure)
    inches = np.array([place.width * figure.get_figwidth(), place.height * figure.get_figheight()])
    extent = (high - low + 2 * margin * np.max(high - low)) / inches
    half = np.max(extent) * inches / 2
    middle = (low + high) / 2
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_xlabel("tip.x  (mm)")
    axes.set_ylabel("tip.y  (mm)")


def _background(axes: Axes, scene: Scene, machine: Machine, working: Working) -> list[Patch | Line2D]:
    """Draws reach, singular loci and stops of a working mode in light colours; returns the legend's entries."""
    far = 100 * MM * machine.size
    axes.add_patch(Rectangle((-far, -far), 2 * far, 2 * far, facecolor=REACHED, edgecolor="none", zorder=0))
    hide_outside(axes, machine)
    curves = direct_curves(machine, working) + stop_curves(scene, machine, working)
    handles: list[Patch | Line2D] = [*draw_loci(axes, machine, curves, 0.6)]
    stops = [curve.tip for curve in curves if curve.kind == "stop"]
    for tip in stops:
        axes.plot(*(tip.T * MM), color=GREY, linewidth=1.4, linestyle="--", zorder=3)
    if stops:
        handles.append(Line2D([], [], color=GREY, linewidth=1.4, linestyle="--", label="a motor at its stop"))
    axes.plot(*(machine.motors.T * MM), "^", color=BLACK, markersize=6, zorder=9)
    return handles


def _overview(axes: Axes, made: Plan) -> None:
    _background(axes, made.scene, made.machine, made.working)
    for part in strokes_of(made.tip, made.pen):
        axes.plot(*(part.T * MM), color=TIP, linewidth=0.9, zorder=7)
    row = int(np.argmax(made.pen))
    joints = chain(made.machine, made.theta[row], made.tip[row]) * MM
    axes.plot(*joints.T, color=WHITE, linewidth=3.6, zorder=7.9, solid_joinstyle="round")
    draw_legs(axes, joints, 1.6)
    _frame(axes, np.concatenate([_corners(made.machine), joints / MM]), 0.03)


def _lines(axes: Axes, outcome: Outcome, band: float, line: float) -> None:
    """Draws the commanded path as a band and the path of the tip with the pen down as a line."""
    made = outcome.plan
    for commanded, done in zip(strokes_of(made.tip, made.pen), strokes_of(outcome.tip, made.pen)):
        axes.plot(
            *(commanded.T * MM),
            color=COMMANDED,
            linewidth=band,
            zorder=5,
            solid_capstyle="round",
            solid_joinstyle="round",
        )
        axes.plot(*(done.T * MM), color=BLACK, linewidth=line, zorder=6, solid_joinstyle="round")


def _window(outcome: Outcome) -> Floats:
    """Corners of the window around the largest error with the pen down, m, (2, 2)."""
    made = outcome.plan
    row = int(np.argmax(np.where(made.pen, outcome.off, -1)))
    middle = (outcome.tip[row] + made.tip[row]) / 2
    half = max(ZOOM / 2 * float(outcome.off[row]), float(np.max(made.drawing.box[1] - made.drawing.box[0])) / 80)
    return np.stack([middle - half, middle + half])


def _sheet(axes: Axes, outcome: Outcome, window: Floats) -> None:
    made = outcome.plan
    _lines(axes, outcome, 3.2, 0.9)
    lifted = [way for way in strokes_of(made.tip, ~made.pen) if np.ptp(way, axis=0).max() > SEEN]
    for way in lifted:
        axes.plot(*(way.T * MM), color=GREY, linewidth=0.6, linestyle=(0, (2, 3)), zorder=3)
    _frame(axes, np.concatenate([made.tip, outcome.tip, window]), 0.03)
    handles = [
        Line2D([], [], color=COMMANDED, linewidth=3.2, label="commanded"),
        Line2D([], [], color=BLACK, linewidth=0.9, label="done by the machine"),
    ]
    if lifted:
        handles.append(Line2D([], [], color=GREY, linewidth=0.6, linestyle=(0, (2, 3)), label="pen lifted"))
    axes.legend(handles=handles, loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False, borderaxespad=0.2)


def _enlarged(axes: Axes, outcome: Outcome, sheet: Axes, window: Floats) -> None:
    """Draws the window with the largest error, and its frame on the sheet."""
    _lines(axes, outcome, 6.0, 1.2)
    _frame(axes, window, 0.0)
    sheet.add_patch(
        Rectangle(
            tuple(window[0] * MM),
            *((window[1] - window[0]) * MM),
            fill=False,
            edgecolor=WRONG,
            linewidth=1.0,
            zorder=8,
        )
    )
    for spine in axes.spines.values():
        spine.set_edgecolor(WRONG)


def _shade(axes: Axes, made: Plan) -> None:
    """Shades the times with the pen down."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], made.pen, [False]]).astype(int)))
    for begin, end in zip(edges[::2], edges[1::2]):
        axes.axvspan(made.time[max(begin - 1, 0)], made.time[end - 1], facecolor="#eeeeee", edgecolor="none", zorder=0)
    axes.set_xlim(0, made.time[-1])
    axes.set_xlabel("time  (s)")


def _errors(axes: Axes, outcome: Outcome) -> None:
    made = outcome.plan
    _shade(axes, made)
    time, late, off = thinned(made.time, outcome.late, np.where(made.pen, outcome.off, 0.0), buckets=BUCKETS)
    axes.plot(time, late * MM, color=SKY, linewidth=0.9, label="from the commanded position")
    axes.plot(time, off * MM, color=BLACK, linewidth=1.0, label="from the drawing, pen down")
    axes.set_ylim(0, None)
    axes.legend(loc="upper left", bbox_to_anchor=(-0.05, -0.32), frameon=False, ncols=1, borderaxespad=0)


def _torques(axes: Axes, outcome: Outcome, limits: Limits) -> None:
    made = outcome.plan
    _shade(axes, made)
    for leg, colour, width in ((0, LEFT, 1.2), (1, RIGHT, 0.8)):
        most = limits.torques[leg]
        label = f"{SIDES[leg]} motor" + (f", limit {most:g} N·m" if np.isfinite(most) else "")
        axes.plot(
            *thinned(made.time, outcome.torque[:, leg], buckets=BUCKETS), color=colour, linewidth=width, label=label
        )
        if np.abs(outcome.torque).max() > 0.4 * most:
            for side in (-1, 1):
                axes.axhline(side * most, color=colour, linewidth=0.8, linestyle=(0, (1, 2) if leg else (4, 3)))
    axes.legend(loc="upper left", bbox_to_anchor=(-0.05, -0.32), frameon=False, borderaxespad=0)
