"""Pictures of a map: the condition number in each working mode and, if torques are limited, the tip force.

The colours by Okabe and Ito and the colour map `cividis` are safe for colour-blind readers. Lines also differ in style. The
legend is below the axes.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, PathPatch
from matplotlib.path import Path as Outline
from matplotlib.patheffects import Stroke, withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from fivebar.borders import Curve
from fivebar.colours import KIND_COLOURS, LEFT, RIGHT, TIP
from fivebar.kinematics import WORKING_MODES, Machine, mode_name
from fivebar.workspace import Map, Mode

if TYPE_CHECKING:
    from matplotlib.typing import LineStyleType, RcKeyType

Floats = NDArray[np.float64]

BLACK, GREY, SKY, WHITE = "#000000", "#6c757d", "#56b4e9", "#ffffff"
DIRECT, INVERSE = KIND_COLOURS["direct"], KIND_COLOURS["inverse"]

MM = 1e3
"""Factor from m to mm, the unit of all pictures."""

LEFT_ROOM, BELOW_ROOM = 0.75, 2.2
"""Room to the left of and below the axes, inches."""

KAPPAS = (np.inf, 20.0, 10.0, 5.0, 3.0, 2.0, 1.5, 1.0)
"""Condition numbers at the limits between colours."""

BENDS = {"plus": "counter-clockwise", "minus": "clockwise"}

STYLE: "dict[RcKeyType, Any]" = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "hatch.linewidth": 0.6,
    "legend.fontsize": 8,
    "svg.fonttype": "path",
    "svg.hashsalt": "fivebar",  # the same map gives the same file
}


def draw(survey: Map, folder: str | Path) -> list[Path]:
    """Draws `condition_MODE` and `force_MODE` as .svg and .png to a folder; returns the files."""
    directory = Path(folder)
    directory.mkdir(parents=True, exist_ok=True)
    files = []
    with matplotlib.rc_context(STYLE):
        for mode in survey.modes:
            kinds = {"condition": condition_picture} | ({"force": force_picture} if mode.force is not None else {})
            for kind, picture in kinds.items():
                figure = picture(survey, mode)
                for suffix in ("svg", "png"):
                    files.append(directory / f"{kind}_{mode.name}.{suffix}")
                    figure.savefig(
                        files[-1], dpi=150, bbox_inches="tight", metadata={"Date": None} if suffix == "svg" else None
                    )
    return files


def condition_picture(survey: Map, mode: Mode) -> Figure:
    """The condition number over the reach, with all loci."""
    figure, axes, bar = _page(survey, mode)
    levels = [1 / kappa for kappa in KAPPAS]
    field = axes.contourf(
        survey.x * MM, survey.y * MM, mode.dexterity, levels=levels, colors=scale_colours(len(levels) - 1), zorder=1
    )
    field.set_rasterized(True)
    colour_bar = figure.colorbar(field, cax=bar, spacing="uniform")
    colour_bar.set_ticks(levels, labels=["∞" if np.isinf(kappa) else f"{kappa:g}" for kappa in KAPPAS])
    colour_bar.set_label("condition number of the Jacobian  (1)")
    _finish(axes, survey, mode, [])
    return figure


def scale_colours(count: int) -> list[str]:
    """Colours of a scale with `count` steps, from dark to light."""
    return [to_hex(colour) for colour in matplotlib.colormaps["cividis"](np.linspace(0, 1, count))]


def force_picture(survey: Map, mode: Mode) -> Figure:
    """The force that the tip at rest can hold in every direction, over the reach."""
    assert mode.force is not None and survey.limits is not None
    figure, axes, bar = _page(survey, mode)
    handles: list[Patch] = []
    if len(levels := force_levels(mode)):
        values = np.clip(mode.force, -1e9, 1e9)
        field = axes.contourf(
            survey.x * MM, survey.y * MM, values, levels=levels, cmap="cividis", extend="max", zorder=1
        )
        field.set_rasterized(True)
        figure.colorbar(field, cax=bar).set_label("force that the tip holds in every direction  (N)")
    else:
        bar.set_axis_off()
    if np.any(mode.force[mode.reached & mode.within_stops] <= 0):
        lacking = np.clip(mode.force, -1e9, 1e9)
        axes.contourf(
            survey.x * MM, survey.y * MM, lacking, levels=[-2e9, 0.0], colors=[WHITE], hatches=["xxx"], zorder=1.1
        )
        handles.append(Patch(facecolor=WHITE, edgecolor=BLACK, hatch="xxx", label="the motors do not carry the weight"))
    _finish(axes, survey, mode, handles)
    axes.text(0, 1.01, load_words(survey), transform=axes.transAxes, va="bottom", fontsize=8)
    return figure


def force_levels(mode: Mode) -> Floats:
    """Forces at the limits between colours, N: from 0 to the 90 % quantile over the reach; empty if no force can be held."""
    assert mode.force is not None
    known = mode.force[mode.reached & mode.within_stops]
    positive = known[(known > 0) & np.isfinite(known)]
    if not len(positive):
        return np.zeros(0)
    levels = np.array(MaxNLocator(8).tick_values(0.0, float(np.percentile(positive, 90))))
    return levels[levels >= 0]


def load_words(survey: Map) -> str:
    """Torque limits and payload of a force field, as text."""
    assert survey.limits is not None
    left, right = survey.limits
    load = (
        f"payload {float(survey.scene['payload.mass']) * 1e3:g} g" if survey.scene["payload.enabled"] else "no payload"
    )
    return f"torques up to {left:g} N·m left, {right:g} N·m right; {load}"


def _page(survey: Map, mode: Mode) -> tuple[Figure, Axes, Axes]:
    """A figure with axes of equal scales in mm, and the axes of its colour bar."""
    shown = np.concatenate(
        [survey.machine.motors, _posture(survey, mode), np.stack([survey.x[[0, -1]], survey.y[[0, -1]]], axis=-1)]
    )
    low, high = shown.min(axis=0), shown.max(axis=0)
    margin = 0.03 * float(np.max(high - low))
    low, high = (low - margin) * MM, (high + margin) * MM
    # In inches: the axes, then room for labels, colour bar and legend.
    width, height = (4.4 * (high - low) / np.max(high - low)).tolist()
    size = LEFT_ROOM + width + 1.2, BELOW_ROOM + height + 0.9
    figure = Figure(figsize=size)
    axes = figure.add_axes((LEFT_ROOM / size[0], BELOW_ROOM / size[1], width / size[0], height / size[1]))
    bar = figure.add_axes(
        ((LEFT_ROOM + width + 0.15) / size[0], BELOW_ROOM / size[1], 0.16 / size[0], height / size[1])
    )
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_xlabel("tip.x  (mm)")
    axes.set_ylabel("tip.y  (mm)")
    left, right = (BENDS[bend] for bend in mode.working)
    machine = survey.machine
    axes.set_title(
        f"{survey.scene.name}, working mode {mode.name}: left leg {left}, right leg {right}\n"
        f"links 1 to 4: {', '.join(f'{length * MM:g}' for length in machine.lengths)} mm; motors {machine.distance * MM:g} mm apart",
        pad=16,
    )
    return figure, axes, bar


def _finish(axes: Axes, survey: Map, mode: Mode, more: list[Patch]) -> None:
    """Draws everything above the field, and the legend."""
    hide_outside(axes, survey.machine)
    handles = [
        *more,
        *_stops(axes, survey, mode),
        *draw_loci(axes, survey.machine, mode.curves),
        *_discs(axes, survey, mode),
        *_path(axes, survey, mode),
    ]
    handles += _machine(axes, survey, mode)
    assert isinstance(axes.figure, Figure)
    height = axes.figure.get_figheight() - BELOW_ROOM - 0.9
    axes.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0, -0.5 / height),
        frameon=False,
        borderaxespad=0,
        handlelength=2.6,
    )


def hide_outside(axes: Axes, machine: Machine) -> None:
    """Paints the area out of reach white. The fields continue there, so their visible borders are the exact circles."""
    far = 100 * MM * machine.size
    frame = np.array([(-far, -far), (-far, far), (far, far), (far, -far), (-far, -far)])
    for circle in machine.inverse_singularities():
        centre, radius = np.array(circle.centre) * MM, circle.radius * MM
        if circle.posture == "folded":
            axes.add_patch(Circle(tuple(centre), radius, facecolor=WHITE, edgecolor="none", zorder=2))
            continue
        # Opposite directions of the frame and the circle leave a hole.
        hole = Outline.circle(tuple(centre), radius)
        outline = Outline(np.concatenate([frame, hole.vertices]), np.concatenate([_codes(len(frame)), hole.codes]))
        axes.add_patch(PathPatch(outline, facecolor=WHITE, edgecolor="none", zorder=2))


def _codes(count: int) -> NDArray[np.uint8]:
    return np.array([Outline.MOVETO] + [Outline.LINETO] * (count - 2) + [Outline.CLOSEPOLY], dtype=np.uint8)


def _stops(axes: Axes, survey: Map, mode: Mode) -> list[Patch | Line2D]:
    """Hatches the area with a motor beyond its stops, and draws the arcs with a motor at a stop."""
    if not survey.scene["stop.enabled"]:
        return []
    margin = np.clip(mode.stop_margin, -10, 10)
    hatched = axes.contourf(
        survey.x * MM, survey.y * MM, margin, levels=[-20, 0], colors=["#ffffffb0"], hatches=["////"], zorder=1.5
    )
    hatched.set_edgecolor(GREY)
    for curve in mode.curves:
        if curve.kind == "stop":
            axes.plot(*(curve.tip.T * MM), color=GREY, linewidth=1.6, zorder=3)
    return [Patch(facecolor=WHITE, edgecolor=GREY, hatch="////", label="beyond a motor's stops")]


def draw_loci(axes: Axes, machine: Machine, curves: list[Curve], weight: float = 1.0) -> list[Line2D]:
    """Draws circles and curves of singularities, in mm, with line widths scaled by `weight`; returns the legend's entries."""
    thin, thick = 1.3 * weight, 1.6 * weight
    handles = [
        Line2D(
            [],
            [],
            color=INVERSE,
            linewidth=thin,
            label="inverse singularity: a leg stretched or folded (rim of the reach)",
        )
    ]
    for circle in machine.inverse_singularities():
        if circle.radius > 0:
            centre = circle.centre[0] * MM, circle.centre[1] * MM
            _within(
                axes,
                machine,
                Circle(centre, circle.radius * MM, fill=False, edgecolor=INVERSE, linewidth=thin, zorder=4),
                circle.leg,
            )
    names = {
        "stretched": "direct singularity: distal links stretched" + (" (Watt's curve)" if machine.is_symmetric else ""),
        "folded": "direct singularity: distal links folded",
    }
    styles: dict[str, LineStyleType] = {"stretched": "-", "folded": (0, (4, 1.5))}
    for posture, style in styles.items():
        shown = [curve.tip for curve in curves if curve.kind == "direct" and curve.detail == posture]
        for tip in shown:
            (line,) = axes.plot(*(tip.T * MM), color=DIRECT, linewidth=thick, linestyle=style, zorder=5)
            line.set_path_effects([withStroke(linewidth=thick + 1.4, foreground=WHITE)] if style == "-" else [])
        if shown:
            handles.append(Line2D([], [], color=DIRECT, linewidth=thick, linestyle=style, label=names[posture]))
    return handles


def _within(axes: Axes, machine: Machine, patch: Circle, leg: int) -> None:
    """Adds the part of a leg's circle within the reach of the other leg."""
    other = machine.motors[1 - leg] * MM
    radius = machine.reach[1 - leg, 1] * MM * (1 + 1e-3)
    axes.add_patch(patch)
    patch.set_clip_path(Circle(tuple(other), radius, transform=axes.transData))


def _discs(axes: Axes, survey: Map, mode: Mode) -> list[Line2D]:
    """Draws the largest discs without singularity; returns the legend's entries."""
    if survey.machine.is_degenerate(mode.working):
        return [Line2D([], [], linestyle="none", label="every posture is a direct singularity")]
    handles = []
    shown = [disc for disc in mode.discs if disc.radius > 0.3 * mode.discs[0].radius]
    styles = {"plus": (0, (6, 2)), "minus": (0, (1.5, 1.5))}
    for disc in shown:
        circle = Circle(
            (disc.x * MM, disc.y * MM), disc.radius * MM, fill=False, edgecolor=SKY, linewidth=1.4, zorder=6
        )
        circle.set_linestyle(styles[disc.assembly])
        axes.add_patch(circle)
    for assembly, style in styles.items():
        sizes = ", ".join(f"{disc.radius * MM:.1f}" for disc in shown if disc.assembly == assembly)
        if sizes:
            label = f"largest discs without singularity, assembly {assembly}: radius {sizes} mm"
            handles.append(Line2D([], [], color=SKY, linewidth=1.4, linestyle=style, label=label))
    return handles


def _path(axes: Axes, survey: Map, mode: Mode) -> list[Line2D]:
    """Draws the scene's motion in this working mode, and faintly in other modes; returns the legend's entries."""
    if survey.path is None:
        return []
    tip = survey.path.tip * MM
    parts = survey.path.parts(mode.working)
    casing = [Stroke(linewidth=3.2, foreground=WHITE)]
    whole = sum(part.stop - part.start for part in parts) >= len(tip)
    handles = []
    if not whole:
        axes.plot(*tip.T, color=GREY, linewidth=0.7, linestyle=":", zorder=6.5)
        handles.append(
            Line2D([], [], color=GREY, linewidth=0.7, linestyle=":", label="motion of the scene in other working modes")
        )
    for part in parts:
        axes.plot(*tip[part].T, linewidth=3.2, color=WHITE, zorder=7, path_effects=casing)
        axes.plot(*tip[part].T, linewidth=1.6, color=TIP, zorder=7.1)
    if parts:
        handles.append(Line2D([], [], color=TIP, linewidth=1.6, label="motion of the scene, from the ring"))
        if parts[0].start == 0:
            axes.plot(
                *tip[0],
                "o",
                markerfacecolor=WHITE,
                markeredgecolor=TIP,
                markersize=5,
                markeredgewidth=1.4,
                zorder=10,
            )
    return handles


def _posture(survey: Map, mode: Mode) -> Floats:
    """Joints of the machine, m, shape (5, 2) or (0, 2): at the motion's start if it is in this mode, otherwise in a large disc."""
    machine, path = survey.machine, survey.path
    if path is not None and any(part.start == 0 for part in path.parts(mode.working)):
        return chain(machine, path.theta[0], path.tip[0])
    if not mode.discs:
        return np.zeros((0, 2))
    disc = max(mode.discs, key=lambda disc: (disc.y >= 0, disc.radius))
    tip = np.array([disc.x, disc.y]) + 0.4 * disc.radius * np.array([0.6, 0.8])
    return chain(machine, machine.field(tip, mode.working)[0].theta, tip)


def _machine(axes: Axes, survey: Map, mode: Mode) -> list[Line2D]:
    """Draws the machine in one posture, with its motors; returns the legend's entries."""
    axes.plot(*(survey.machine.motors.T * MM), "^", color=BLACK, markersize=7, zorder=9)
    joints = _posture(survey, mode) * MM
    if not len(joints):
        return [Line2D([], [], color=BLACK, marker="^", linestyle="none", markersize=6, label="motors")]
    axes.plot(*joints.T, color=WHITE, linewidth=4.2, zorder=7.9, solid_joinstyle="round")
    draw_legs(axes, joints, 2.0)
    return [
        Line2D([], [], color=colour, linewidth=2.0, marker="o", markersize=3.5, label=label)
        for colour, label in ((LEFT, "left leg of the machine, with its motors ▲"), (RIGHT, "right leg"))
    ]


def draw_legs(axes: Axes, joints: Floats, width: float) -> None:
    """Draws the legs of a posture, in mm; `joints` are from `chain`."""
    for colour, rows in ((LEFT, [0, 1, 2]), (RIGHT, [2, 3, 4])):
        axes.plot(*joints[rows].T, color=colour, linewidth=width, marker="o", markersize=1.75 * width, zorder=8)


def chain(machine: Machine, theta: Floats, tip: Floats) -> Floats:
    """Positions of left motor, left elbow, tip, right elbow and right motor, m, shape (5, 2)."""
    left = machine.lengths[0] * np.array([np.cos(theta[0]), np.sin(theta[0])])
    right = machine.motors[1] + machine.lengths[3] * np.array([np.cos(theta[3]), np.sin(theta[3])])
    return np.stack([machine.motors[0], left, tip, right, machine.motors[1]])


def draw_modes(machine: Machine, tip: tuple[float, float], file: str | Path) -> None:
    """Draws the machine with its tip at a point, m, in each working mode, with link numbers and the signs that define the mode."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 5.0))
        grid = figure.subplots(2, 2, sharex=True, sharey=True)
        for axes, working in zip(grid.flat, WORKING_MODES):
            posture = machine.inverse(tip, working)
            joints = chain(machine, posture.theta, posture.tip) * MM
            axes.plot(*(machine.motors.T * MM), "^", color=BLACK, markersize=8, zorder=3)
            axes.plot(*joints[[1, 3]].T, color=SKY, linewidth=1.2, linestyle=":", zorder=1)
            axes.annotate("", joints[3], joints[1], arrowprops={"arrowstyle": "->", "color": SKY, "linestyle": ":"})
            draw_legs(axes, joints, 2.2)
            for link, (begin, end) in enumerate(((0, 1), (1, 2), (3, 2), (4, 3))):
                middle = joints[begin] + 0.4 * (joints[end] - joints[begin])
                text = axes.text(*middle, f"{link + 1}", ha="center", va="center", fontsize=9, zorder=9)
                text.set_bbox(
                    {
                        "boxstyle": "circle,pad=0.15",
                        "facecolor": WHITE,
                        "edgecolor": (LEFT, RIGHT)[link > 1],
                        "linewidth": 0.8,
                    }
                )
            signs = ["> 0" if bend == "plus" else "< 0" for bend in working]
            side = "> 0" if posture.assembly == "plus" else "< 0"
            axes.set_title(
                f"{mode_name(working)}: s₁₂ {signs[0]}, s₄₃ {signs[1]}\nassembly {posture.assembly}: s₂₃ {side}",
                fontsize=8.5,
            )
            axes.set_aspect("equal")
            axes.margins(0.12)
            for spine in ("top", "right"):
                axes.spines[spine].set_visible(False)
        for axes in grid[1]:
            axes.set_xlabel("x  (mm)")
        for axes in grid[:, 0]:
            axes.set_ylabel("y  (mm)")
        figure.tight_layout()
        figure.savefig(file, metadata={"Date": None} if Path(file).suffix == ".svg" else None)
