"""An animated SVG: the mechanism, the path of its tip and the singularities that it passes.

The SVG uses `animate` elements and no script, so it also plays in a browser that shows it as an image. All animations share
one clock and repeat: a short rest at the start, the run, a rest at the end. Without animation, for example on paper, the
picture shows the start and the whole path.
"""

import html
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fivebar.colours import KIND_COLOURS, LEFT, RIGHT, TIP
from fivebar.drawing import BARRIER, FAINT, INK, extent, plane, thinned
from fivebar.drive import Run
from fivebar.scene import Scene
from fivebar.singularities import PAIRS, Event, alignments

SLOWER = 2
"""Factor by which the picture is slower than the mechanism. The title says "half speed"."""

LONGEST = 5.0
"""Longest run, s, with an animated picture: longer ones would take megabytes."""

FIRST, LAST, FADE = 0.5, 1.5, 0.3
"""Seconds of rest at the start and at the end, and of fading in and out."""

FRAME, TURN = 0.02, 0.06
"""Time, s, and turn of a link, rad, after which a new frame comes; the picture interpolates between frames."""

PULSE = 0.6
"""Seconds for which a ring marks a singularity."""

WIDTH, HEIGHT = 880, 456
MACHINE = (16, 44, 420, 396)
"""The panel of the mechanism: left, top, width, height."""

CURVES = (486, 78, 370, 90, 124)
"""The panels of the three curves: left, top, width and height of each, and the distance between two tops."""

CAPTIONS = tuple(f"{pair} in line: {kind} singularity" for pair, kind in zip(PAIRS, ("direct", "inverse", "inverse")))
ANGLES = ("theta[1]", "passive.theta[1]", "passive.theta[2]", "theta[2]")
JOINTS = ("tip", "elbow[1]", "elbow[2]")
"""The joint of each of `PAIRS`."""


def wanted(run: Run) -> bool:
    """Whether the run is short enough and the mechanism moves."""
    return bool(run.time[0] == 0 < run.time[-1] <= LONGEST)


def write(path: Path, scene: Scene, run: Run, events: list[Event]) -> None:
    """Writes the picture."""
    clock, view = Clock(run.time[-1]), View.of(run)
    frames = frames_of(run)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" role="img">',
        f"<title>{html.escape(scene.name)}: the mechanism in motion, and the singularities that it goes through</title>",
        STYLE,
        f'<rect x="0.5" y="0.5" width="{WIDTH - 1}" height="{HEIGHT - 1}" rx="8" fill="#ffffff" stroke="#dee2e6"/>',
        f'<text class="title" x="24" y="30">{html.escape(scene.name)}, at half speed</text>',
        _surroundings(run, view),
        '<g clip-path="url(#machine)">',
        f"<g>{clock.fade()}{_path(run, view, clock, frames)}</g>",
        _legs(run, view, clock, frames),
        f"<g>{''.join(_pulses(run, view, clock, event) for event in events)}</g>",
        "</g>",
        _curves(run, clock, events),
        "</svg>\n",
    ]
    path.write_text("\n".join(parts), encoding="utf-8", newline="\n")


STYLE = f"""<style>
text {{ font: 12px system-ui, "Segoe UI", Helvetica, Arial, sans-serif; fill: #495057 }}
.title {{ font-size: 15px; font-weight: 600; fill: {INK} }}
polyline, path {{ fill: none; stroke-linejoin: round; stroke-linecap: round }}
.link {{ stroke-width: 6 }}
.thin {{ stroke: #e9ecef; stroke-width: 1 }}
</style>"""


@dataclass(frozen=True)
class Clock:
    """Time of the picture, as a share of one repetition."""

    run: float

    @property
    def seconds(self) -> float:
        """Duration of one repetition."""
        return FIRST + SLOWER * self.run + LAST

    def share(self, time: float) -> float:
        """Share of a repetition at which the picture shows the time `time` of the run."""
        return (FIRST + SLOWER * time) / self.seconds

    def animate(self, attribute: str, moments: list[float], values: list[str]) -> str:
        """Animates `attribute` with `values` at `moments` (shares of a repetition); it is constant before and after them."""
        moments, values = [0.0, *moments, 1.0], [values[0], *values, values[-1]]
        keys = ";".join(_number(moment, 5) for moment in moments)
        return (
            f'<animate attributeName="{attribute}" dur="{_number(self.seconds, 3)}s" repeatCount="indefinite" '
            f'keyTimes="{keys}" values="{";".join(values)}"/>'
        )

    def fade(self) -> str:
        """Fades out a growing drawing at the end of a repetition."""
        end, fade = 1.0, FADE / self.seconds
        return self.animate("opacity", [0.0, fade, end - fade, end], ["0", "1", "1", "0"])


@dataclass(frozen=True)
class View:
    """Transform from metres to the panel of the mechanism."""

    left: float
    top: float
    scale: float

    @classmethod
    def of(cls, run: Run) -> "View":
        """A view with the whole motion in the middle of the panel."""
        (x0, x1), (y0, y1) = extent(run, "x"), extent(run, "y")
        left, top, width, height = MACHINE
        scale = min(width / (x1 - x0), height / (y1 - y0))
        return cls(left + width / 2 - scale * (x0 + x1) / 2, top + height / 2 + scale * (y0 + y1) / 2, scale)

    def points(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """One row per point."""
        return np.column_stack((self.left + self.scale * np.asarray(x), self.top - self.scale * np.asarray(y)))


def frames_of(run: Run) -> np.ndarray:
    """Indices of the samples to draw: at regular times, and more often while a link turns fast."""
    turned = np.cumsum(np.max([np.abs(np.diff(run[name], prepend=run[name][0])) for name in ANGLES], axis=0))
    cells = np.floor(run.time / FRAME + 1e-9), np.floor(turned / TURN)
    new = np.any([np.diff(cell, prepend=-1) > 0 for cell in cells], axis=0)
    new[-1] = True
    return np.flatnonzero(new)


def _path(run: Run, view: View, clock: Clock, frames: np.ndarray) -> str:
    """The path of the tip up to the current time."""
    points = view.points(run["tip.x"], run["tip.y"])[frames]
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    left = clock.animate(
        "stroke-dashoffset", [clock.share(t) for t in run.time[frames]], [_number(way[-1] - w, 1) for w in way]
    )
    # The gap is longer than the path; otherwise the next dash would show as a dot at the end.
    length, gap = _number(way[-1], 1), _number(way[-1] + 20, 1)
    return (
        f'<polyline stroke="{TIP}" stroke-width="1.8" opacity="0.75" stroke-dasharray="{length} {gap}" '
        f'points="{_list(points)}">{left}</polyline>'
    )


def _legs(run: Run, view: View, clock: Clock, frames: np.ndarray) -> str:
    """The two legs, from motor to elbow to tip. The joints are markers, which move with the lines."""
    tip = view.points(run["tip.x"], run["tip.y"])[frames]
    moments = [clock.share(t) for t in run.time[frames]]
    legs = []
    for leg, foot, colour, end in (
        (1, 0.0, LEFT, ""),
        (2, run.parameters["base.distance"], RIGHT, ' marker-end="url(#tip)"'),
    ):
        (start,) = view.points(np.array([foot]), np.array([0.0]))
        elbow = view.points(run[f"elbow[{leg}].x"], run[f"elbow[{leg}].y"])[frames]
        poses = [_list(np.array([start, *joints])) for joints in zip(elbow, tip)]
        legs.append(
            f'<polyline class="link" stroke="{colour}" marker-mid="url(#elbow{leg})"{end} points="{poses[0]}">'
            f"{clock.animate('points', moments, poses)}</polyline>"
        )
    markers = "".join(
        _marker(name, *look) for name, look in (("elbow1", (LEFT, 5)), ("elbow2", (RIGHT, 5)), ("tip", (TIP, 6)))
    )
    return f"<defs>{markers}</defs>\n" + "\n".join(legs)


def _marker(name: str, colour: str, radius: float) -> str:
    """The marker of a joint: a white disc with a coloured edge."""
    size = 2 * radius + 4
    return (
        f'<marker id="{name}" markerUnits="userSpaceOnUse" markerWidth="{size}" markerHeight="{size}" refX="{size / 2:g}" '
        f'refY="{size / 2:g}"><circle cx="{size / 2:g}" cy="{size / 2:g}" r="{radius}" fill="#ffffff" stroke="{colour}" '
        'stroke-width="2.5"/></marker>'
    )


def _pulses(run: Run, view: View, clock: Clock, event: Event) -> str:
    """A growing ring around each joint with its links in line."""
    begin = clock.share(event.time)
    end = begin + PULSE / clock.seconds
    rings = []
    for joint, posture in zip(JOINTS, event.postures):
        if posture:
            ((x, y),) = view.points(*(np.interp([event.time], run.time, run[f"{joint}.{axis}"]) for axis in "xy"))
            rings.append(
                f'<circle cx="{_number(x, 1)}" cy="{_number(y, 1)}" r="7" fill="none" stroke="{KIND_COLOURS[event.kind]}" '
                f'stroke-width="3" opacity="0">{clock.animate("r", [begin, end], ["7", "30"])}'
                f"{clock.animate('opacity', [begin, begin, end], ['0', '1', '0'])}</circle>"
            )
    return "".join(rings)


def _surroundings(run: Run, view: View) -> str:
    """Panel, grid, motors, length scale and obstacles."""
    p, (left, top, width, height) = run.parameters, MACHINE
    base, first = p["base.distance"], p["link[1].length"]
    parts = [f'<clipPath id="machine"><rect x="{left}" y="{top}" width="{width}" height="{height}"/></clipPath>']
    parts.append('<g clip-path="url(#machine)">')
    if p["contact.enabled"]:
        normal, offset = plane(run)
        along, deep = 1e3 * first * np.array([-normal[1], normal[0]]), 0.12 * first * normal
        corners = np.array([normal * offset + way for way in (along, -along, -along - deep, along - deep)])
        parts.append(f'<polygon fill="{BARRIER}" stroke="{FAINT}" points="{_list(view.points(*corners.T))}"/>')
    for leg, foot, link in ((1, 0.0, 1), (2, base, 4)):
        if p["stop.enabled"] and p[f"stop.upper[{leg}]"] - p[f"stop.lower[{leg}]"] < 2 * np.pi:
            angles = np.linspace(p[f"stop.upper[{leg}]"], p[f"stop.lower[{leg}]"] + 2 * np.pi, 60)
            radius = 0.3 * p[f"link[{link}].length"]
            x, y = foot + radius * np.cos(angles), radius * np.sin(angles)
            wedge = view.points(np.append(x, foot), np.append(y, 0.0))
            parts.append(f'<polygon fill="{BARRIER}" stroke="{FAINT}" points="{_list(wedge)}"/>')
    ground = view.points(np.array([0.0, base]), np.zeros(2))
    parts.append(f'<polyline stroke="{FAINT}" stroke-dasharray="1 4" stroke-width="1.5" points="{_list(ground)}"/>')
    parts += [f'<path fill="{INK}" style="fill: {INK}" d="M{_list([foot])}l-9,15h18z"/>' for foot in ground]
    parts.append("</g>")
    # The scale is the largest power of ten, or half of one, that takes at most a quarter of the panel.
    longest = width / 4 / view.scale
    power = 10 ** np.floor(np.log10(longest))
    bar = power if longest < 5 * power else 5 * power
    level, end = top + height - 8, left + 8 + bar * view.scale
    parts.append(f'<path stroke="#868e96" stroke-width="1.5" d="M{left + 8},{level - 4}v4H{_number(end, 1)}v-4"/>')
    parts.append(f'<text x="{_number(end + 8, 1)}" y="{level}">{bar:g} m</text>')
    return "\n".join(parts)


def _curves(run: Run, clock: Clock, events: list[Event]) -> str:
    """Sine of the angle between the links of each pair over time; the curves grow as the mechanism moves."""
    left, top, width, height, distance = CURVES
    scale = width / run.time[-1]
    share = [clock.share(0.0), clock.share(run.time[-1])]
    end = top + (len(PAIRS) - 1) * distance + height
    parts = [f'<text class="title" x="{left}" y="30">sine of the angle between two links</text>']
    grown = ['<g clip-path="url(#grown)">', clock.fade()]
    for pair, signal in enumerate(alignments(run)):
        y = top + pair * distance
        middle, tall = y + height / 2, height / 2 - 4
        kind = "direct" if pair == 0 else "inverse"
        parts.append(f'<rect x="{left}" y="{y}" width="{width}" height="{height}" fill="#f8f9fa"/>')
        parts.append(f'<path class="thin" style="stroke: {FAINT}" d="M{left},{middle:g}h{width}"/>')
        parts.append(f'<text x="{left}" y="{y - 8}" style="fill: {KIND_COLOURS[kind]}">{CAPTIONS[pair]}</text>')
        time, value = thinned(run.time, signal, buckets=150)
        points = np.column_stack((left + scale * time, middle - tall * value))
        grown.append(f'<polyline stroke="{INK}" stroke-width="1.4" points="{_list(points)}"/>')
        for event in events:
            if event.postures[pair]:
                x, colour = _number(left + scale * event.time, 1), KIND_COLOURS[event.kind]
                grown.append(f'<circle cx="{x}" cy="{middle:g}" r="4.5" fill="{colour}" stroke="#ffffff"/>')
    grown.append("</g>")
    for tick in _ticks(run.time[-1]):
        x = _number(left + scale * tick, 1)
        parts.append(f'<text x="{x}" y="{end + 18}" text-anchor="middle">{tick:g}{" s" if tick == 0 else ""}</text>')
    # The window is wider than the panel by the radius of dots at its edges.
    grow = clock.animate("width", [*share, share[1]], ["5", str(width + 5), str(width + 10)])
    window = f'<rect x="{left - 5}" y="{top - 5}" width="{width + 10}" height="{end - top + 10}">{grow}</rect>'
    parts.append(f'<clipPath id="grown">{window}</clipPath>')
    move = clock.animate("x", share, [str(left - 0.75), str(left + width - 0.75)])
    parts += grown
    for pair in range(len(PAIRS)):
        y = top + pair * distance
        parts.append(
            f'<rect x="{left - 0.75}" y="{y - 3}" width="1.5" height="{height + 6}" fill="{TIP}">{move}</rect>'
        )
    return "\n".join(parts)


def _ticks(end: float) -> np.ndarray:
    """At most five round times up to the end."""
    step = next(step for step in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50) if end / step <= 5 or step == 50)
    return np.arange(0, end * (1 + 1e-9), step)


def _list(points: np.ndarray | list[np.ndarray]) -> str:
    return " ".join(f"{_number(x, 1)},{_number(y, 1)}" for x, y in points)


def _number(value: float, digits: int) -> str:
    """A number without trailing zeros."""
    text = f"{value:.{digits}f}"
    return (text.rstrip("0").rstrip(".") if "." in text else text) or "0"
