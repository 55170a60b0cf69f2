"""Drawings: strokes of files, pieces by arc length, blocked places, timing within limits, the drawn result."""

import csv
import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from fivebar import path_pictures, paths, pieces, scene, simulate, statics, strokes
from fivebar.borders import stop_margin
from fivebar.demand import Demand
from fivebar.errors import FiveBarError
from fivebar.kinematics import WORKING_MODES, Machine, Working, sines
from fivebar.paths import Blocked, Limits
from fivebar.pieces import Piece, Timing
from fivebar.scene import Scene
from instance import Instance
from made_scene import TABLE

REPOSITORY = Path(__file__).resolve().parents[2]
LOGO = REPOSITORY / "examples" / "fivebar.svg"
HEAD = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" {}>{}</svg>'
CORNER = '<path d="M0 0 L10 0 L10 5"/>'
SLOW = Timing("constant", 0.1, 2.0)


@pytest.fixture
def drawing(tmp_path: Path) -> Callable[..., strokes.Drawing]:
    """Reads an SVG of these attributes and elements."""

    def make(attributes: str = "", body: str = CORNER) -> strokes.Drawing:
        file = tmp_path / "drawing.svg"
        file.write_text(HEAD.format(attributes, body), encoding="utf-8")
        return strokes.read(file)

    return make


def line(*points: tuple[float, float]) -> np.ndarray:
    """A stroke of straight lines, m."""
    chain = np.array(points)
    return chain[:-1, None] + np.linspace(0, 1, 4)[:, None] * np.diff(chain, axis=0)[:, None]


# Strokes


@pytest.mark.parametrize(
    ("attributes", "width", "height"),
    [
        ("", 10, 5),
        ('viewBox="0 0 50 50"', 10, 5),
        ('width="100%" height="100%" viewBox="10 10 50 30"', 10, 5),
        ('width="100mm" height="100mm" viewBox="0 0 50 50"', 20, 10),
        ('width="100" height="100" viewBox="0 0 50 50"', 20, 10),
        ('width="2in" viewBox="0 0 50 25"', 10.16, 5.08),
        ('width="10cm" height="auto" viewBox="0,0,50,25"', 20, 10),
        ('width="100mm" height="50mm" viewBox="0 0 50 50" preserveAspectRatio="none"', 20, 5),
    ],
)
def test_units_of_an_svg(drawing: Callable[..., strokes.Drawing], attributes: str, width: float, height: float) -> None:
    """An inch is off by 5e-7, because svgelements has rounded factors."""
    low, high = 1e3 * drawing(attributes).box
    assert high - low == pytest.approx([width, height], rel=1e-6)


def test_shapes_and_transforms(drawing: Callable[..., strokes.Drawing]) -> None:
    """y points up; each shape, transform and reference gives the right curve."""
    cases = {
        '<circle r="3" cx="5" cy="1"/>': [(2, -4), (8, 2)],
        '<g transform="translate(5 5) rotate(90) scale(2)"><rect width="4" height="2" rx="1"/></g>': [
            (1, -13),
            (5, -5),
        ],
        # An ellipse under a skew is an ellipse of half width sqrt(rx^2 + (ry tan 30)^2).
        '<ellipse rx="2" ry="1" transform="skewX(30)"/>': [(-math.sqrt(4 + 1 / 3), -1), (math.sqrt(4 + 1 / 3), 1)],
        '<polygon points="0,0 1,1 2,0"/>': [(0, -1), (2, 0)],
        '<line x1="0" y1="1mm" x2="1cm" y2="0"/>': [(0, -1), (10, 0)],
        '<path d="M0 0 Q1 2 2 0 T4 0"/>': [(0, -1), (4, 1)],
        '<path d="m1 1 h2 v3 c0 1 -1 1 -1 0 s -1 -1 -1 0 z"/>': [(1, -4.75), (3, -1)],
        '<path d="M0 0 A2 2 0 0 1 4 0"/>': [(0, 0), (4, 2)],
        '<defs><path id="a" d="M0 0h5"/></defs><use href="#a" x="3"/><use xlink:href="#a" y="2"/>': [(0, -2), (8, 0)],
        '<clipPath id="c"><path d="M0 0 H99"/></clipPath><path d="M0 0h1"/><path d="M0 0h7" display="none"/>': [
            (0, 0),
            (1, 0),
        ],
    }
    for body, box in cases.items():
        # The box is taken from 16 points of a curve; arcs are cubics, exact to 1e-8.
        assert 1e3 * drawing(body=body).box == pytest.approx(np.array(box), abs=5e-3), body
    circle = drawing(body='<circle r="30"/>').strokes[0]
    assert np.abs(np.hypot(*strokes.points_of(circle, 50).reshape(-1, 2).T) - 0.03).max() < 1e-9


def test_what_is_no_line_is_said(drawing: Callable[..., strokes.Drawing]) -> None:
    made = drawing(
        body=f'{CORNER}<text>hello</text><symbol id="s"><path d="M0 0h9"/></symbol><use href="#s"/><image width="2" height="2" href="x.png"/>'
    )
    assert len(made.strokes) == 1 and len(made.left_out) == 3
    assert "'hello'" in " ".join(made.left_out) and "symbol #s" in " ".join(made.left_out)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.svg", "<svg", "it is no XML"),
        ("a.svg", "<html/>", "its first element is <html>, not <svg>"),
        ("a.svg", HEAD.format("", '<path d="M0 0 L foo"/>'), "a path's data have 'f', which is no command"),
        ("a.svg", HEAD.format("", '<path d="M0 0 L 1e999 0"/>'), "a point is not finite"),
        ("a.svg", HEAD.format('viewBox="a b c d"', CORNER), "its viewBox is 'a b c d': it must be four numbers"),
        ("a.svg", HEAD.format("", "<text>hi</text>"), "has no line to draw. The text 'hi' is left out"),
        ("a.svg", HEAD.format("", '<path d="M1 1"/>'), "has no line to draw"),
        ("a.csv", "", "has no line to draw"),
        ("a.csv", "1,2\n3,b\n", "row 2 is '3,b': it must be x,y or x,y,pen"),
        ("a.csv", "1,2,2\n3,4,1\n", "row 1 is '1,2,2'"),
        ("a.csv", "foo,bar\n1,2", "its header is 'foo,bar'"),
        ("a.csv", "x [m],y [mm]\n1,2", "its header is 'x [m],y [mm]'"),
        ("a.png", "", "a drawing is an .svg or a .csv, not .png"),
        ("b.svg", None, "cannot be read: No such file"),
    ],
)
def test_drawings_that_are_none(tmp_path: Path, name: str, content: str | None, sentence: str) -> None:
    if content is not None:
        (tmp_path / name).write_text(content, encoding="utf-8")
    with pytest.raises(FiveBarError, match=re.escape(sentence)) as refused:
        strokes.read(tmp_path / name)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("rows", ["x [m];y[m]\n0;0\n0,1;0\n", "x [m]\ty [m]\n0\t0\n0.1\t0\n", "0;0\n100,0;0\n"])
def test_a_csv_as_spreadsheets_write_it(rows: str, encoding: str, tmp_path: Path) -> None:
    """Semicolons or tabs, decimal commas, byte order marks."""
    file = tmp_path / "drawing.csv"
    file.write_text(rows, encoding=encoding)
    (stroke,) = strokes.read(file).strokes
    assert stroke[0, 0].tolist() == [0.0, 0.0] and stroke[0, 3] == pytest.approx([0.1, 0.0], abs=1e-15)


def test_rows_of_a_csv(tmp_path: Path) -> None:
    """Lengths are in the header's unit or mm; `pen` tells whether the pen is down on the way to this row; y points up."""
    file = tmp_path / "drawing.csv"
    file.write_text("x [m],y [m],pen\n0,0,1\n0.1,0,1\n.1,.1,0\n.2,.1,1\n.2,.1,1\n", encoding="utf-8")
    first, second = strokes.read(file).strokes
    assert first[0, [0, 3]].tolist() == [[0, 0], [0.1, 0]] and second[:, [0, 3]].tolist() == [[[0.1, 0.1], [0.2, 0.1]]]
    file.write_text("\ufeff0,0\n\n10, 5\n", encoding="utf-8")
    assert strokes.read(file).box == pytest.approx(np.array([[0, 0], [0.01, 0.005]]))


def test_a_drawing_is_placed(drawing: Callable[..., strokes.Drawing]) -> None:
    made = drawing(body='<circle r="3"/><path d="M0 0 L10 0"/>')
    assert made.placed((0.1, 0.2)).box.mean(axis=0) == pytest.approx([0.1, 0.2], abs=1e-12)
    assert np.ptp(made.placed((0.1, 0.2), 0.26).box, axis=0) == pytest.approx([0.26, 0.12], rel=1e-3)
    assert np.ptp(drawing(body='<path d="M0 0 V4"/>').placed((0, 0), 0.1).box, axis=0) == pytest.approx([0, 0.1])


# Pieces and their timing


def test_a_piece_goes_by_arc_length(drawing: Callable[..., strokes.Drawing]) -> None:
    """On a circle equal arc lengths are equal angles and the curvature is 1/r; on a cubic the tangent is the derivative by arc length."""
    (circle,) = pieces.of(drawing(body='<circle r="30" cx="5"/>').strokes)
    assert circle.length == pytest.approx(2 * np.pi * 0.03, rel=1e-8)
    place, tangent, curvature = circle.at(way := np.linspace(0, circle.length, 1001))
    assert np.abs(np.hypot(*(place - (0.005, 0)).T) - 0.03).max() < 1e-9
    assert np.hypot(*np.diff(place, axis=0).T) == pytest.approx(0.06 * np.sin(np.diff(way) / 0.06), rel=1e-7)
    # Cubics replace arcs; their second derivatives are off by 1e-5.
    assert np.hypot(*curvature.T) * 0.03 == pytest.approx(np.ones(1001), abs=1e-4)
    (cubic,) = pieces.of(drawing(body='<path d="M0 0 C 5 15 20 -10 30 10"/>').strokes)
    place, tangent, curvature = cubic.at(way := np.linspace(0, cubic.length, 4001))
    step = way[1]
    assert np.abs((place[2:] - place[:-2]) / (2 * step) - tangent[1:-1]).max() < 1e-4
    assert (
        np.abs((place[2:] - 2 * place[1:-1] + place[:-2]) / step**2 - curvature[1:-1]).max()
        < 1e-2 * np.abs(curvature).max()
    )


def test_corners_are_rests_and_pens_are_lifted() -> None:
    made = pieces.of([line((0, 0), (1, 0), (2, 0.05), (2, 1)), line((2, 1), (3, 1)), line((3, 2), (4, 2))])
    assert [(piece.stroke, piece.pen, len(piece.curves)) for piece in made] == [
        (1, True, 2),
        (1, True, 1),
        (2, True, 1),
        (3, False, 1),
        (3, True, 1),
    ]


@pytest.mark.parametrize("profile", ["constant", "minimumJerk"])
@pytest.mark.parametrize("length", [1e-3, 0.1])
def test_profiles(profile: pieces.Profile, length: float) -> None:
    """A piece begins and ends at rest; speed and acceleration stay within their limits, and one of them reaches its limit."""
    timing = Timing(profile, 0.1, 2.0)
    share = np.linspace(0, 1, 20001)
    way, rate, change = timing.way(length, share)
    duration = timing.duration(length)
    assert [way[0], way[-1], rate[0], rate[-1]] == pytest.approx([0, length, 0, 0], abs=1e-12)
    assert np.abs(np.gradient(way, share) - rate)[1:-1].max() < 1e-3 * length
    assert np.median(np.abs(np.gradient(rate, share) - change)) < 1e-3 * length
    speed, acceleration = rate.max() / duration / 0.1, np.abs(change).max() / duration**2 / 2.0
    assert max(speed, acceleration) == pytest.approx(1, abs=1e-6) and min(speed, acceleration) < 1 + 1e-9
    # By hand: 0.9601 rad in 0.5 s.
    assert 1.875 * 0.9601 / 0.5 == pytest.approx(3.600375) and 10 / np.sqrt(3) * 0.9601 / 0.25 == pytest.approx(
        22.172560, rel=1e-7
    )


# Places at which a path is blocked


STOPS = {"stop.enabled": True, "stop.lower[1]": 0.9, "stop.upper[1]": 2.9, "stop.lower[2]": 0.2, "stop.upper[2]": 2.2}


def table(values: dict[str, float | bool] | None = None) -> Scene:
    """A robot on a table."""
    content = {"description": "trial", "tip.x": 0.05, "tip.y": 0.25} | TABLE | (values or {})
    return scene.parse("table", json.dumps(content))


ALMOST_ALIKE = [{"link[2].length": 0.3, "link[3].length": 0.3 + more} for more in (5e-17, 1e-12, 1e-9, 1e-7, 1e-5)]


@pytest.mark.parametrize(
    "values",
    [
        {},
        STOPS,
        {"base.distance": 0.25, "link[2].length": 0.3, "link[3].length": 0.22, "link[4].length": 0.17},
        ALMOST_ALIKE[0],
        *(pytest.param(values, marks=pytest.mark.nightly) for values in ALMOST_ALIKE[1:-1]),
        ALMOST_ALIKE[-1],
    ],
)
@pytest.mark.parametrize("working", WORKING_MODES[:3])
@pytest.mark.parametrize(
    ("drawn", "lines", "least"), [(1000, 60, 5), pytest.param(4000, 100, 10, marks=pytest.mark.nightly)]
)
def test_lines_are_blocked_where_they_meet_a_border(
    values: dict[str, float | bool], working: Working, drawn: int, lines: int, least: int
) -> None:
    """Random lines are compared with dense sampling: free lines cross no border; blocked ones are free up to the reported place, and not behind it."""
    made = table(values)
    machine = Machine.from_scene(made)
    random = np.random.default_rng(7)
    outcomes = {"free": 0, "blocked": 0}

    def side(places: np.ndarray) -> np.ndarray:
        """The assembly, 1 or -1, at allowed places of the tip; 0 elsewhere."""
        posture, reached = machine.field(places, working)
        return np.where(reached & (stop_margin(made, posture.motors) >= 0), np.sign(sines(posture.theta)[..., 0]), 0)

    places = random.uniform((-0.3, -0.4), (0.4, 0.4), (drawn, 2))
    for begin in places[side(places) != 0][:lines]:
        end = begin + random.uniform(-0.15, 0.15, 2)
        sequence = [Piece(line(tuple(begin), tuple(end)), 1, True)]
        shares = np.linspace(0, 1, 4001)[:, None]
        sides = side(begin + shares * (end - begin))
        crossed = np.flatnonzero(sides != sides[0])
        try:
            paths.check(made, machine, working, sequence)
        except Blocked as blocked:
            outcomes["blocked"] += 1
            way = np.hypot(*(blocked.place - begin)) / np.hypot(*(end - begin))
            assert np.all(sides[shares[:, 0] < way - 1e-3] == sides[0])
            # A line that only touches a border does not cross it, but it is closer than the tolerance allows.
            assert not len(crossed) or abs(shares[crossed[0], 0] - way) < 1e-3, str(blocked)
        else:
            outcomes["free"] += 1
            assert not len(crossed)
    # Both outcomes are tested, each by about a tenth of the lines or more.
    assert sum(outcomes.values()) == lines and min(outcomes.values()) > least, outcomes


@pytest.mark.parametrize(
    ("values", "stroke", "place", "sentence"),
    [
        # The end of the right leg's reach: 0.42 m from (0.1, 0).
        (
            {},
            line((0.05, 0.3), (-0.2, 0.3)),
            (0.1 - math.sqrt(0.42**2 - 0.3**2), 0.3),
            "reaches the limit of the right leg: 0.42 m from its motor the leg is stretched",
        ),
        # Watt's curve on the axis: y = sqrt(l^2 - (l - a)^2).
        (
            {},
            line((0.05, 0.3), (0.05, 0.1)),
            (0.05, math.sqrt(0.21**2 - 0.16**2)),
            "meets a direct singularity of working mode minusPlus: the distal links are stretched",
        ),
        ({}, line((0.5, 0.3), (0.05, 0.3)), (0.5, 0.3), "is 0.1631 m too far for the left leg"),
        (
            {"stop.enabled": True, "stop.upper[1]": 2.5},
            line((0.05, 0.3), (-0.2, 0.2)),
            None,
            "meets stop.upper[1] = 2.5 rad",
        ),
        (
            {"stop.enabled": True, "stop.upper[1]": 2.5},
            line((-0.2, 0.2), (0.05, 0.3)),
            (-0.2, 0.2),
            "has a motor beyond its stops",
        ),
        ({"base.distance": 0.1, "link[1].length": 0.1}, line((0.02, 0.25), (0.02, 0.0)), None, "leg"),
    ],
)
def test_reasons_and_places(
    values: dict[str, float | bool], stroke: np.ndarray, place: tuple[float, float] | None, sentence: str
) -> None:
    made = table(values | ({"tip.x": 0.0, "tip.y": 0.25} if "stop.enabled" in values else {}))
    with pytest.raises(Blocked, match=re.escape(sentence)) as blocked:
        paths.plan(made, strokes.Drawing([stroke]), SLOW)
    assert str(blocked.value).startswith("Stroke 1, at (")
    if place is not None:
        assert blocked.value.place == pytest.approx(place, abs=2e-6)


def test_work_on_blocked_drawings_is_bounded(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No arc length is computed, and all strokes of the picture are one artist."""
    drawing = strokes.Drawing([line((0.05, 0.3), (0.05, 0.31), (0.06, 0.31)), line((0.05, 0.3), (-0.2, 0.3))] * 50)
    monkeypatch.setattr(pieces, "_lengths", None)
    with pytest.raises(Blocked) as blocked:
        paths.plan(table(), drawing, SLOW)
    figures: list[Figure] = []
    monkeypatch.setattr(path_pictures, "_save", lambda figure, *_: figures.append(figure))
    path_pictures.draw_blocked(table(), ("minus", "plus"), drawing, blocked.value, "trial", tmp_path)
    assert all(len(axes.lines) < 50 for axes in figures[0].axes)
    assert all(any(len(each.get_paths()) == 100 for each in axes.collections) for axes in figures[0].axes)


def test_a_drawing_that_takes_too_long_is_refused_before_the_work_on_its_pieces(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawing = strokes.Drawing([line((0.05, 0.3), (0.05, 0.31))] * 10_000)
    monkeypatch.setattr(pieces, "_lengths", None)
    monkeypatch.setattr(paths, "borders", None)
    with pytest.raises(FiveBarError, match=r"takes 3000 s or more, but up to 1000 s are allowed in steps of 0.001 s"):
        paths.plan(table(), drawing, SLOW)


def test_ways_with_lifted_pen_are_checked() -> None:
    """Two strokes, left and right of the direct locus, are free, but not the way between them."""
    left, right = line((-0.1, 0.05), (-0.1, 0.06)), line((0.2, 0.05), (0.2, 0.06))
    for stroke in (left, right):
        paths.check(table(), Machine.from_scene(table()), ("minus", "plus"), pieces.of([stroke]))
    with pytest.raises(Blocked, match="The way with lifted pen to stroke 2, at .* meets a direct singularity"):
        paths.plan(table(), strokes.Drawing([left, right]), SLOW)


# Plans


@pytest.fixture(scope="module")
def logo() -> strokes.Drawing:
    """The shipped drawing on the table."""
    return strokes.read(LOGO).placed((0.05, 0.26), 0.18)


def test_rates_are_derivatives(logo: strokes.Drawing) -> None:
    """Tip, angles and rates of a plan are consistent; while the pen is down, its speed is as commanded."""
    made = paths.plan(table(), logo, SLOW)
    assert np.abs(made.machine.forward(made.theta[:, [0, 3]]).tip - made.tip).max() < 1e-13
    velocity = made.machine.tip_velocity(made.theta, made.omega)
    speed = np.hypot(*velocity.T)
    assert speed.max() == pytest.approx(0.1, rel=1e-2) and speed.max() < 0.1 + 1e-12
    # At jumps of the acceleration, 2 m/s2 and centripetal v^2/r with r down to 1.1 mm, central differences err by half a step times the jump.
    assert np.abs(np.gradient(made.tip, made.time, axis=0) - velocity).max() < 0.5e-3 * (2 + 0.1**2 / 1.1e-3)
    assert made.drawn == pytest.approx(sum(piece.length for piece in pieces.of(logo.strokes) if piece.pen), rel=1e-4)
    assert not made.pen[0] and np.all(made.theta[0] == made.theta[1])


LOADED = {
    "gravity.enabled": True,
    "payload.enabled": True,
    "payload.mass": 0.1,
    "friction.enabled": True,
    "viscous.enabled": True,
    "spring.enabled": True,
}


def test_torques_of_a_plan_move_the_unit_as_planned(new: Callable[..., Instance], logo: strokes.Drawing) -> None:
    """At rest they equal statics; in motion they give the unit in co-simulation the planned acceleration."""
    still = table({"gravity.enabled": True, "payload.enabled": True})
    made = paths.plan(still, logo, SLOW)
    assert made.torque[0] == pytest.approx(statics.holding_torques(still, made.theta[0]), abs=1e-10)  # as below
    loaded, random = table(LOADED), np.random.default_rng(3)
    theta = Machine.from_scene(loaded).inverse(random.uniform((-0.1, 0.2), (0.2, 0.3), (12, 2))).theta
    omega, alpha = random.uniform(-3, 3, (12, 2)), random.uniform(-50, 50, (12, 2))
    with Demand(loaded, theta[0]) as demand:
        torques = demand.torques(theta, omega, alpha)
    for posture, rates, wanted, torque in zip(theta, omega, alpha, torques):
        values = dict(loaded.values) | {
            "servo.enabled": False,
            "init.theta[1]": posture[0],
            "init.theta[2]": posture[3],
        }
        values |= {f"init.omega[{i + 1}]": rates[i] for i in (0, 1)} | {f"tau[{i + 1}]": torque[i] for i in (0, 1)}
        unit = new().initialise(values)
        # Round-off: torques come from differences of accelerations, some 1e4 rad/s2 per N.m.
        assert [unit.get("alpha[1]"), unit.get("alpha[2]")] == pytest.approx(wanted, abs=1e-8)


def test_accelerations_are_second_derivatives() -> None:
    """Against central differences along a circle, in each working mode of an asymmetric machine."""
    machine = Machine.from_values(
        {
            "base.distance": 0.25,
            "link[1].length": 0.2,
            "link[2].length": 0.3,
            "link[3].length": 0.22,
            "link[4].length": 0.17,
        }
    )
    time = np.linspace(0, 1, 20001)
    angle, step = 2 * np.pi * time, time[1]
    way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    tip, velocity, acceleration = (
        (0.1, 0.24) + 0.03 * way,
        0.06 * np.pi * way[:, ::-1] * (-1, 1),
        -0.12 * np.pi**2 * way,
    )
    for working in WORKING_MODES:
        theta = machine.inverse(tip, working).theta
        alpha = machine.motor_accelerations(theta, velocity, acceleration)
        omega = machine.motor_rates(theta, velocity)
        # Truncation, h^2/6 of the fourth derivative, and round-off, 1e-15/h: both some 1e-7 of 1e2 rad/s2.
        assert np.abs((omega[2:] - omega[:-2]) / (2 * step) - alpha[1:-1]).max() < 1e-5 * np.abs(alpha).max()


def test_limits_are_kept_by_taking_longer(logo: strokes.Drawing) -> None:
    """Limits hold at every communication point; only pieces that need it take longer, and a limit is nearly reached."""
    fast = Timing("constant", 0.5, 20.0)
    free = paths.plan(table(LOADED), logo, fast)
    most = 0.6 * np.abs(free.torque).max()
    for limits in (Limits(rate=0.5 * np.abs(free.omega).max()), Limits(torques=(most, most))):
        made = paths.plan(table(LOADED), logo, fast, limits=limits)
        shares = np.abs(made.omega).max() / limits.rate, np.abs(made.torque).max() / limits.torques[0]
        # Counts of steps are whole: a piece of some 20 steps may take one too many.
        assert 0.85 < max(shares) <= 1 + 1e-12
        assert made.time[-1] > free.time[-1] and 0 < made.slowed < len(pieces.of(logo.strokes))
    with pytest.raises(
        Blocked,
        match=r"Stroke 1, at \(.*\) m, needs .* N·m of the left motor however slow it is: the limit is 0.01 N·m",
    ):
        paths.plan(table(LOADED), logo, fast, limits=Limits(torques=(0.01, 0.01)))


def test_refusals_of_plans(logo: strokes.Drawing) -> None:
    with pytest.raises(FiveBarError, match="speed = -1 m/s: it must be positive and finite"):
        Timing("constant", -1, 1)
    with pytest.raises(FiveBarError, match="every posture of this machine is a direct singularity"):
        paths.plan(table({"base.distance": 0.0}), logo, SLOW, ("plus", "plus"))


# The command


def fivebar(folder: Path, fmu: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """Runs `fivebar path`."""
    command = [sys.executable, "-m", "fivebar", "path", *map(str, words)]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, env=os.environ | {"FIVEBAR_FMU": str(fmu)}
    )


def test_the_command_draws(tmp_path: Path, fmu: Path) -> None:
    """The command writes a scene for any run, a table and a picture; the machine follows the table and stays near the drawing."""
    done = fivebar(
        tmp_path,
        fmu,
        "pick_and_place",
        LOGO,
        "--at",
        "0.05,0.26",
        "--size",
        "0.18",
        "--speed",
        "0.2",
        "--profile",
        "minimumJerk",
    )
    assert done.returncode == 0, done.stderr
    off = re.search(r"from the drawing with the pen down: up to ([0-9.]+) mm, ([0-9.]+) mm rms", done.stdout)
    assert off and 0 < float(off[2]) < float(off[1]) < 2.0
    folder = tmp_path / "pick_and_place"
    made = scene.read(folder / "fivebar.json")
    assert made.values["payload.enabled"] and set(made.signals) == {
        f"servo.{what}[{i}]" for what in ("theta", "omega") for i in (1, 2)
    }
    with (folder / "fivebar.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    column = lambda name: np.array([float(row[name]) for row in rows])
    assert np.abs(made.signals["servo.theta[1]"] - column("theta[1]")).max() < 1e-12
    result = simulate.run(made)
    assert np.abs(result["tip.x"] - column("done.x")).max() < 1e-12 and {0.0, 1.0} == set(column("pen"))
    late = np.hypot(column("done.x") - column("tip.x"), column("done.y") - column("tip.y"))
    assert np.abs(late - column("late")).max() < 1e-15 and np.all(
        column("off")[column("pen") == 1] <= late[column("pen") == 1] + 1e-12
    )
    with Image.open(folder / "drawn.png") as picture:
        assert min(picture.size) > 900 and len(picture.convert("RGB").getcolors(1_000_000) or []) > 20


def test_one_short_line_shows_its_window(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The window about the worst place lies within the sheet, and the legend lists a lifted pen only if there is one."""
    (tmp_path / "line.csv").write_text("x,y\n0,0\n10,0\n", encoding="utf-8")
    limits = Limits(torques=(1.0, 1.0))
    made = paths.plan(
        scene.read("pick_and_place"),
        strokes.read(tmp_path / "line.csv").placed((0.05, 0.26), None),
        Timing("constant", 0.1, 2.0),
        limits=limits,
    )
    paths.write_scene(made, tmp_path / "line.json", "line.csv")
    drawn: list[Figure] = []
    monkeypatch.setattr(path_pictures, "_save", lambda figure, *_: drawn.append(figure))
    path_pictures.draw(paths.compare(made, simulate.run(tmp_path / "line.json")), "line.csv", limits, tmp_path)
    [sheet] = [axes for axes in drawn[0].axes if axes.get_title(loc="left").startswith("c")]
    assert [text.get_text() for text in sheet.get_legend().get_texts()] == ["commanded", "done by the machine"]
    window, (low, high) = sheet.patches[-1].get_bbox(), sheet.get_ylim()
    assert low < window.y0 < window.y1 < high


def test_the_command_refuses(tmp_path: Path, fmu: Path) -> None:
    """One sentence, exit code 2; the picture of a blocked drawing marks the place."""
    cases = [
        (
            ("pick_and_place", LOGO, "--at", "0.05,0.12", "--size", "0.25"),
            "meets a direct singularity of working mode minusPlus",
        ),
        (("fall_90_120", LOGO, "--at", "0.2,0.2"), "servo.enabled = false"),
        (("pick_and_place", LOGO, "--at", "here"), "is not a place X,Y in m"),
        (("pick_and_place", LOGO), "Missing option '--at'"),
        (("pick_and_place", LOGO, "--at", "0.05,0.26", "--speed", "0"), "0.0 is not in the range x>0"),
        (("pick_and_place", "none.svg", "--at", "0.05,0.26"), "none.svg: it cannot be read"),
    ]
    for words, sentence in cases:
        done = fivebar(tmp_path, fmu, *words)
        assert done.returncode == 2 and done.stdout == "" and len(done.stderr.splitlines()) == 1, done.stderr
        assert sentence in done.stderr
    assert sorted(file.name for file in (tmp_path / "pick_and_place").iterdir()) == ["blocked.png", "blocked.svg"]
