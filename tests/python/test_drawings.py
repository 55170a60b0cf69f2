"""Drawings of common programs: units, hidden shapes, nested pages, references, and files refused after bounded work."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fivebar import strokes, svg
from fivebar.errors import FiveBarError

HEAD = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" {}>{}</svg>'
LINE = '<path d="M0 0 H10"/>'
CSS_PX = 25.4 / 96
MM = {
    "mm": 1.0,
    "cm": 10.0,
    "in": 25.4,
    "Q": 0.25,
    "pt": 25.4 / 72,
    "pc": 25.4 / 6,
    "px": CSS_PX,
    "MM": 1.0,
    "Pt": 25.4 / 72,
}

Read = Callable[..., strokes.Drawing]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    """Reads an SVG of these elements and attributes."""

    def make(body: str = LINE, attributes: str = "") -> strokes.Drawing:
        file = tmp_path / "drawing.svg"
        file.write_text(HEAD.format(attributes, body), encoding="utf-8")
        return strokes.read(file)

    return make


def box(drawing: strokes.Drawing) -> np.ndarray:
    """Left, lower, right and upper end, mm, y upwards."""
    return 1e3 * drawing.box.ravel()


# Units


@pytest.mark.parametrize("unit", MM)
@pytest.mark.parametrize("sides", [("width",), ("height",), ("width", "height")])
def test_absolute_units_of_a_page(read: Read, unit: str, sides: tuple[str, ...]) -> None:
    size = {"width": 72, "height": 36}
    made = read(
        '<path d="M0 0H72V36"/>', " ".join(f'{name}="{size[name]}{unit}"' for name in sides) + ' viewBox="0 0 72 36"'
    )
    assert box(made) == pytest.approx(np.array([0, -36, 72, 0]) * MM[unit])
    assert ("px are 25.4/96 mm" in " ".join(made.left_out)) == (unit == "px")


@pytest.mark.parametrize("unit", MM)
@pytest.mark.parametrize(
    ("attributes", "px"), [("", 1.0), ('width="90mm" height="90mm"', CSS_PX), ('width="90mm" viewBox="0 0 45 45"', 2.0)]
)
def test_absolute_units_of_a_shape(read: Read, unit: str, attributes: str, px: float) -> None:
    """If the page has a unit, a user unit is a px or as the viewBox scales it; otherwise a mm."""
    user = MM[unit] if not attributes else MM[unit] / CSS_PX
    assert box(read(f'<line x2="10{unit}"/>', attributes))[2] == pytest.approx(10 * user * px)
    assert box(read(f'<rect width="10{unit}" height="1"/>', attributes))[2] == pytest.approx(10 * user * px)


def test_a_page_that_fits_a_window_has_the_size_of_its_attributes(read: Read) -> None:
    page = 'width="100mm" viewBox="0 0 50 50" style="width: 100%; height: auto"'
    assert box(read(LINE, page))[2] == pytest.approx(20)
    assert box(read(LINE, page.replace("100%", "25mm")))[2] == pytest.approx(5)


def test_a_page_without_view_box_is_in_px(read: Read) -> None:
    made = read(LINE, 'width="100mm" height="50mm"')
    assert box(made)[2] == pytest.approx(10 * CSS_PX) and "px are 25.4/96 mm" in made.left_out[0]
    assert box(read(LINE, 'width="100" height="50"'))[2] == pytest.approx(10)


@pytest.mark.parametrize(
    "value",
    ["100,5mm", "10m", "10em", "10rem", "10ex", "10vw", "10 mm mm", "mm", "foo", "nan", "inf", "1e999mm", "calc(1mm)"],
)
@pytest.mark.parametrize("name", ["width", "height", "x2"])
def test_other_units_are_refused_by_name(read: Read, name: str, value: str) -> None:
    what = f"{name}={value!r}"
    with pytest.raises(
        FiveBarError,
        match=re.escape(
            f"<{'line' if name == 'x2' else 'svg'}> has {what}: it must be a number, without a unit or in mm, cm"
        ),
    ):
        read(f'<line {what} y2="1"/>' if name == "x2" else LINE, "" if name == "x2" else what)


@pytest.mark.parametrize("value", ["0", "-3mm", "0px"])
def test_a_page_has_a_size(read: Read, value: str) -> None:
    with pytest.raises(FiveBarError, match=f"<svg> has width='{value}': it must be positive"):
        read(LINE, f'width="{value}"')


def test_percentages_are_of_the_page(read: Read) -> None:
    """Percentages refer to width or height; for radii to the diagonal over the root of 2."""
    page = 'width="200mm" height="100mm" viewBox="0 0 80 60"'
    scale = 100 / 60
    shift = (200 - 80 * scale) / 2
    diagonal = math.sqrt((80**2 + 60**2) / 2)
    cases = {
        '<line x1="10%" y1="50%" x2="100%" y2="50%"/>': (8, -30, 80, -30),
        '<rect width="50%" height="50%"/>': (0, -30, 40, 0),
        '<circle cx="50%" cy="50%" r="10%"/>': (
            40 - diagonal / 10,
            -30 - diagonal / 10,
            40 + diagonal / 10,
            -30 + diagonal / 10,
        ),
        '<ellipse cx="50%" cy="50%" rx="10%" ry="10%"/>': (32, -36, 48, -24),
    }
    for body, expected in cases.items():
        assert box(read(body, page)) == pytest.approx(np.array(expected) * scale + (shift, 0, shift, 0), abs=1e-6), body
    with pytest.raises(FiveBarError, match="<circle> has r='10%': the page has no size"):
        read('<circle r="10%"/>')


@pytest.mark.parametrize(
    ("aspect", "expected"),
    [
        ("none", (0, -50, 100, 0)),
        ("xMinYMin", (0, -50, 50, 0)),
        ("xMaxYMid meet", (50, -50, 100, 0)),
        ("xMidYMax slice", (0, -50, 100, 50)),
    ],
)
def test_a_view_box_fits_into_its_page(read: Read, aspect: str, expected: tuple[float, ...]) -> None:
    made = read(
        '<path d="M0 0H10V10"/>', f'width="100mm" height="50mm" viewBox="0 0 10 10" preserveAspectRatio="{aspect}"'
    )
    assert box(made) == pytest.approx(np.array(expected))


# Hidden shapes


HIDDEN = {
    "visibility": "hidden",
    "visibility ": "collapse",
    "display": "none",
    "opacity": "0",
    "fill": "none",
    "fill ": "transparent",
    "fill  ": "rgb(0 0 0 / 0)",
    "fill-opacity": "0",
}


@pytest.mark.parametrize(("name", "value"), HIDDEN.items())
def test_hidden_shapes_are_not_drawn(read: Read, name: str, value: str) -> None:
    """Shapes are hidden by attribute, style, or rule of an element, class or id; on the shape, its group, its page or the <use>."""
    name = name.strip()
    rule = f"{name}: {value}"
    path = '<path id="p" class="a b" {}d="M0 0 H10"/>'
    bodies = [
        path.format(f'{name}="{value}" '),
        path.format(f'style="{rule}" '),
        path.format(f'style="{rule} !important" '),
        f'<g {name}="{value}">{path.format("")}</g>',
        f'<g style="{rule}"><g>{path.format("")}</g></g>',
        f'<svg {name}="{value}">{path.format("")}</svg>',
        f'<defs>{path.format("")}</defs><use href="#p" {name}="{value}"/>',
        *(
            f"<style>{selector} {{ {rule} }}</style>{path.format('')}"
            for selector in ("path", ".b", "path.a", "#p", "path#p", "x, .a", "/* c */ .b")
        ),
        f"<style>.a {{ {rule} !important }}</style>"
        + path.format('style="visibility: visible; display: inline; opacity: 1; fill: red; fill-opacity: 1" '),
    ]
    for body in bodies:
        made = read(body + '<line x2="1" fill="red" visibility="visible"/>')
        assert box(made)[2] == pytest.approx(1) and "Hidden elements are not drawn" in " ".join(made.left_out), body


@pytest.mark.parametrize(
    "body",
    [
        '<path fill="currentColor" color="transparent" d="M0 0 H10"/>',
        '<g color="rgb(0 0 0 / 0)"><path style="fill: none; stroke: currentcolor" d="M0 0 H10"/></g>',
        '<g stroke="currentColor" fill="none"><path style="color: transparent" d="M0 0 H10"/></g>',
    ],
)
def test_the_current_colour_may_hide_a_shape(read: Read, body: str) -> None:
    made = read(body + '<line x2="1" fill="currentColor"/>')
    assert box(made)[2] == pytest.approx(1) and "Hidden elements are not drawn" in " ".join(made.left_out)
    assert box(read(re.sub("transparent|rgb.*?\\)", "red", body)))[2] == pytest.approx(10)


def test_shapes_that_only_seem_hidden_are_drawn(read: Read) -> None:
    bodies = [
        '<g visibility="hidden"><path visibility="visible" d="M0 0 H10"/></g>',
        '<g fill="none"><path stroke="#123" d="M0 0 H10"/></g>',
        '<g fill="none" stroke="red"><path fill="inherit" d="M0 0 H10"/></g>',
        '<path style="fill:none;stroke:rgb(1,2,3)" d="M0 0 H10"/>',
        '<path fill="none" stroke="url(#gradient)" d="M0 0 H10"/>',
        '<path opacity="0.01" d="M0 0 H10"/>',
        '<style>path { display: none } .a { display: inline }</style><path class="a" d="M0 0 H10"/>',
        '<style>@media print { path { display: none } }</style><path d="M0 0 H10"/>',
        # Among rules of equal specificity the later one in the sheet wins, whatever order of classes the element has.
        '<style>.a { display: none } .b { display: inline }</style><path class="b a" d="M0 0 H10"/>',
        '<style>path.a { display: none } path.b { display: inline }</style><path class="b a" d="M0 0 H10"/>',
    ]
    for body in bodies:
        assert box(read(body))[2] == pytest.approx(10), body


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        (
            '<clipPath id="c"><path d="M0 0H99"/></clipPath><path id="p" clip-path="url(#c)" d="M0 0H10"/>',
            "The clip path of <path id='p'> is left out",
        ),
        ('<g style="mask: url(#m)"><path d="M0 0H10"/></g>', "The mask of <g> is left out"),
        ('<path marker-end="url(#m)" d="M0 0H10"/>', "The marker of <path> is left out"),
        ('<path stroke-dasharray="1 2" d="M0 0H10"/>', "The dash pattern of <path> is left out"),
        ('<path d="M0 0H10"/><foreignObject><p/></foreignObject>', "A <foreignObject> is left out"),
        ('<path d="M0 0H10"/><use href="#x"/>', "A <use> of '#x' is left out: no element of the drawing has that id"),
        ("<style>g > path { display: none }</style>" + LINE, "The rule 'g > path' of the style sheet is left out"),
        (LINE + '<switch><path systemLanguage="fr" d="M0 0H99"/></switch>', "A <switch> is left out"),
    ],
)
def test_what_changes_lines_and_is_not_read_is_named(read: Read, body: str, sentence: str) -> None:
    made = read(body)
    assert box(made)[2] == pytest.approx(10) and sentence in " ".join(made.left_out)


def test_many_remarks_are_counted(read: Read) -> None:
    said = read(LINE + "".join(f"<text>{i}</text>" for i in range(1000))).left_out
    assert len(said) == svg.MOST_REMARKS + 1 and said[-1] == f"{1000 - svg.MOST_REMARKS} other things are left out."


# Structure


def test_a_switch_draws_one_child(read: Read) -> None:
    children = (
        '<g requiredExtensions="x"><path d="M0 0H99"/></g><path systemLanguage="de" d="M0 0H98"/>'
        '<path systemLanguage="fr, en-GB" d="M0 0H10"/><path d="M0 0H97"/>'
    )
    assert len(made := read(f"<switch>{children}</switch>").strokes) == 1 and made[0][-1, -1, 0] == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        # A shape inherits neither position nor size.
        (
            '<svg x="10" y="20" width="50" height="50" viewBox="0 0 100 100"><rect width="10" height="5"/></svg>',
            (10, -22.5, 15, -20),
        ),
        (
            '<svg x="10" y="20" width="50" height="50"><g><rect x="1" width="5" height="5"/></g></svg>',
            (11, -25, 16, -20),
        ),
        (
            '<svg x="1" y="2" width="50" height="50"><svg width="50%" height="50%" viewBox="0 0 5 5"><path d="M0 0H5"/></svg></svg>',
            (1, -2, 26, -2),
        ),
        (
            '<defs><svg id="s" x="1"><path d="M0 0H5"/></svg></defs><g transform="scale(2)"><use x="3" y="1" href="#s"/></g>',
            (8, -2, 18, -2),
        ),
        (
            '<g transform="translate(10,0)"><g transform="scale(2 3)"><path d="M0 0L5 5" transform="translate(1)"/></g></g>',
            (12, -15, 22, 0),
        ),
        # The size that a <use> gives an <svg>.
        (
            '<defs><svg id="s" width="5" height="5" viewBox="0 0 5 5"><path d="M0 0H5"/></svg></defs><use href="#s" width="10" height="20"/>',
            (0, -5, 10, -5),
        ),
        # An <svg> without size shows nothing.
        ('<svg width="0" viewBox="0 0 5 5"><path d="M0 0H9"/></svg><path d="M0 0H5"/>', (0, 0, 5, 0)),
        # If two elements have the same id, the first one is used.
        ('<defs><path id="p" d="M0 0H5"/><path id="p" d="M0 0H9"/></defs><use href="#p"/>', (0, 0, 5, 0)),
        ('<g x="5" width="9" r="4"><path d="M0 0H5"/><rect height="9"/><circle/></g>', (0, 0, 5, 0)),
        (
            '<path style="transform: rotate(90deg) translateX(10px) scaleY(2)" d="M0 0V-5"/>',
            (0, -10 * CSS_PX, 10, -10 * CSS_PX),
        ),
        ('<path d="M0 0H4" transform="rotate(90)" transform-origin="2 0"/>', (2, -2, 2, 2)),
        (
            '<path d="M0 0H4" style="transform: scale(2); transform-origin: 4px 0"/>',
            (-4 * CSS_PX, 0, 8 - 4 * CSS_PX, 0),
        ),
    ],
)
def test_places_are_those_of_the_standard(read: Read, body: str, expected: tuple[float, ...]) -> None:
    assert box(read(body)) == pytest.approx(np.array(expected), abs=1e-9)


def test_transform_origins_of_the_page(read: Read) -> None:
    page = 'width="40mm" height="20mm" viewBox="0 0 40 20"'
    places = {
        "center": (20, 10),
        "top right": (40, 0),
        "right top": (40, 0),
        "100% 50%": (40, 10),
        "left": (0, 10),
        "5 bottom": (5, 20),
    }
    for origin, (x, y) in places.items():
        made = box(read(f'<path d="M0 0H4" transform="rotate(180)" transform-origin="{origin}"/>', page))
        assert made == pytest.approx([2 * x - 4, -2 * y, 2 * x, -2 * y], abs=1e-9), origin
    with pytest.raises(FiveBarError, match="transform-box='fill-box'"):
        read('<path d="M0 0H4" transform="rotate(9)" style="transform-origin: 1px 1px; transform-box: fill-box"/>')


def test_elements_of_other_programs_are_no_shapes(read: Read) -> None:
    made = read(
        LINE
        + '<i:path xmlns:i="http://www.inkscape.org/namespaces/inkscape" d="M0 0H99"/><metadata><path d="M0 0H98"/></metadata>'
    )
    assert box(made)[2] == pytest.approx(10)


# Bounded work


def nest(depth: int, count: int, inner: str) -> str:
    groups = "".join(f'<g id="g{i}">' + f'<use href="#g{i - 1}"/>' * count + "</g>" for i in range(1, depth + 1))
    return f'<defs><g id="g0">{inner}</g>{groups}</defs><use href="#g{depth}"/>'


@pytest.mark.parametrize(
    ("body", "what"),
    [
        (nest(8, 10, LINE), "strokes"),
        (nest(8, 10, ""), "elements"),
        (nest(3, 10, f'<path d="{" " * 100_000}M0 0"/>'), "characters"),
        (nest(4, 10, '<path d="M0 0' + "h1" * 20 + '"/>'), "curves"),
        ('<circle r="1"/>' * 99_000, "strokes"),
        ('<g><circle r="1"/></g>' * 3_500, "curves"),
        ('<rect width="1" height="1" rx="0.2"/>' * 9_000, "curves"),
        (LINE * 10_001, "strokes"),
        ('<path d="M0 0' + "h1" * 1_000_000 + '"/>', "curves"),
        ('<path d="' + "M0 0" * 1_000_000 + '"/>', "strokes"),
        ("<g/>" * 100_001, "elements"),
        ('<path d="M0 0' + "a1 1 0 0 0 2 2 " * 90_000 + '"/>', "arcs"),
        ('<path d="M0 0' + "a1 1 0 0 0 2 2 " * 20_000 + '"/>', "curves"),
        ('<polyline points="' + "1 1 " * 1_000_000 + '"/>', "curves"),
    ],
)
def test_work_is_bounded_by_counts(read: Read, monkeypatch: pytest.MonkeyPatch, body: str, what: str) -> None:
    """A refusal comes before the allowed numbers of elements and curves are exceeded."""
    counts = {"elements": 0, "curves": 0, "shapes": 0}
    most = {
        "elements": svg.MOST_ELEMENTS,
        "strokes": strokes.MOST_STROKES,
        "curves": strokes.MOST_CURVES,
        "characters": svg.MOST_CHARACTERS,
        "arcs": svg.MOST_ARCS,
    }
    style, cubic, outline = svg._Sheet.style, svg._stroke, svg.Outline

    def counted_style(*values: object) -> object:
        counts["elements"] += 1
        return style(*values)  # type: ignore[arg-type]

    def counted_stroke(curves: list, matrix: np.ndarray) -> list:
        counts["curves"] += len(curves)
        return cubic(curves, matrix)

    def counted_outline(*values: object) -> object:
        counts["shapes"] += 1
        return outline(*values)

    monkeypatch.setattr(svg._Sheet, "style", counted_style)
    monkeypatch.setattr(svg, "Outline", counted_outline)
    monkeypatch.setattr(svg, "_stroke", counted_stroke)
    with pytest.raises(FiveBarError, match=f"it has more than {most[what]} {what}, including repetitions by <use>"):
        read(body)
    assert counts["elements"] <= svg.MOST_ELEMENTS and counts["curves"] <= strokes.MOST_CURVES
    # Too many arcs are refused before svgelements makes one.
    assert what != "arcs" or counts["shapes"] == 0


def test_lines_of_a_csv_are_counted(tmp_path: Path) -> None:
    file = tmp_path / "drawing.csv"
    for count, refused in ((strokes.MOST_CURVES, False), (strokes.MOST_CURVES + 1, True)):
        file.write_text("x,y\n" + "".join(f"{i},1\n" for i in range(count + 1)), encoding="utf-8")
        if refused:
            with pytest.raises(FiveBarError, match="more than 100000 lines"):
                strokes.read(file)
        else:
            assert len(strokes.read(file).strokes[0]) == count


def test_strokes_of_a_csv_are_counted(tmp_path: Path) -> None:
    file = tmp_path / "drawing.csv"
    file.write_text(
        "x,y,pen\n" + "".join(f"{i},1,{i % 2}\n" for i in range(2 * strokes.MOST_STROKES + 1)), encoding="utf-8"
    )
    with pytest.raises(FiveBarError, match="more than 10000 strokes"):
        strokes.read(file)


@pytest.mark.parametrize(
    "body",
    [
        '<g id="a"><use href="#a"/></g>',
        '<use id="a" href="#a"/>',
        '<g id="a"><use href="#b"/></g><g id="b"><g><use xlink:href="#a"/></g></g>',
    ],
)
def test_references_in_a_circle_are_named(read: Read, body: str) -> None:
    with pytest.raises(FiveBarError, match="id='a'> is drawn within itself, by <use>"):
        read(body)


def test_deep_drawings_are_refused(read: Read) -> None:
    assert box(read("<g>" * 150 + LINE + "</g>" * 150))[2] == pytest.approx(10)
    with pytest.raises(FiveBarError, match="elements are nested more than 200 deep"):
        read("<g>" * 50_000 + LINE + "</g>" * 50_000)


# Malformed values


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        ("L1 1", "a path's data begin with 'L', but must begin with M"),
        ("z", "a path's data begin with 'z', but must begin with M"),
        ("5 5", "a path's data begin with '5'"),
        ("M0 0 L1", "have 'L1', which is no command with its numbers"),
        ("M0 0 L1 2 3", "have '3', which is no command"),
        ("M0 0 Z 5", "have '5', which is no command"),
        ("M0 0 A1 1 0 2 0 5 5", "have 'A1 1 0 2 0 5 5', which is no command"),
        ("M0 0 E", "have 'E', which is no command"),
        ("M", "have 'M', which is no command"),
        ("M0 0 L nan 0", "have 'n', which is no command"),
        ("M0 0 A1e308 1e308 0 0 1 5 5", "svgelements makes no lines of <path>"),
        ("M0 0 A1e999 1 0 0 1 5 5", "svgelements makes no lines of <path>"),
        ("M0 0 A1 1 1e999 0 1 5 5", "svgelements makes no lines of <path>"),
        ("M0 0 C1e308 1e308 -1e308 0 1e308 5", "a point is not finite"),
    ],
)
def test_path_data_that_are_none(read: Read, data: str, sentence: str) -> None:
    with np.errstate(all="ignore"), pytest.raises(FiveBarError, match=re.escape(sentence)) as refused:
        read(f'<path d="{data}" transform="scale(10)"/>')
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("data", "end"),
    [
        ("M0 0 10 5", (10, 5)),
        ("m1,1-1.5.5.5.5", (0, 2)),
        ("M0 0 A0 0 0 0 1 3 4", (3, 4)),
        ("M0 0a1 1 0 013 4z m1 1 h2", (3, 1)),
        ("none", None),
        ("", None),
    ],
)
def test_path_data_of_the_standard(read: Read, data: str, end: tuple[float, float] | None) -> None:
    made = read(f'<path d="{data}"/><path d="M9 9h1"/>').strokes
    assert len(made) == (1 if end is None else 2 + ("z" in data))
    if end is not None:
        assert 1e3 * made[-2][-1, -1] == pytest.approx(np.array(end) * (1, -1))


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        ("scale(nan)", "'nan' must be a finite number"),
        ("scale(1e999)", "'1e999' must be a finite number"),
        ("scale(2px)", "'2px' must be a finite number"),
        ("foo(1)", "foo is none of matrix, translate"),
        ("translate(", "it must be a list of functions"),
        ("translate", "it must be a list of functions"),
        ("rotate(30) 5", "it must be a list of functions"),
        ("translate()", "translate must have 1 or 2 arguments, not 0"),
        ("rotate(1 2)", "rotate must have 1 or 3 arguments, not 2"),
        ("matrix(1 0 0 1 0)", "matrix must have 6 arguments, not 5"),
        ("translate(1em)", "it must be a number, without a unit or in mm"),
        ("rotate(3foo)", "'3foo' must be a finite number in deg, rad, grad or turn"),
    ],
)
@pytest.mark.parametrize("element", ["g", "path", "use", "svg"])
def test_transforms_that_are_none(read: Read, element: str, value: str, sentence: str) -> None:
    body = {
        "path": f'<path transform="{value}" d="M0 0H1"/>',
        "use": f'<path id="p" d="M0 0H1"/><use href="#p" transform="{value}"/>',
    }
    with pytest.raises(FiveBarError, match=re.escape(f"<{element}> has transform={value!r}: {sentence}")):
        read(body.get(element, f'<{element} transform="{value}">{LINE}</{element}>'))


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ('<rect width="-1" height="5"/>', "<rect> has width='-1': it must not be less than 0"),
        ('<circle r="-1"/>', "<circle> has r='-1': it must not be less than 0"),
        ('<polygon points="1 2 3"/>', "<polygon> has points='1 2 3': they must be pairs of numbers"),
        ('<polyline points="1 2 a b"/>', "<polyline> has points='1 2 a b'"),
        ('<svg viewBox="0 0 1"><path d="M0 0H1"/></svg>', "its viewBox is '0 0 1': it must be four numbers"),
        ('<svg viewBox="0 0 1 nan"><path d="M0 0H1"/></svg>', "its viewBox is '0 0 1 nan': it must be four numbers"),
        ('<svg viewBox="0 0 1 0"><path d="M0 0H1"/></svg>', "width and height must be positive"),
    ],
)
def test_values_that_are_none(read: Read, body: str, sentence: str) -> None:
    with pytest.raises(FiveBarError, match=re.escape(sentence)):
        read(body)


@pytest.mark.parametrize("encoding", ["utf-7", "utf-32", "foo", "cp037", "rot13"])
def test_other_encodings_are_no_xml(tmp_path: Path, encoding: str) -> None:
    file = tmp_path / "drawing.svg"
    file.write_text(f'<?xml version="1.0" encoding="{encoding}"?>' + HEAD.format("", LINE), encoding="utf-8")
    with pytest.raises(FiveBarError, match="it is no XML"):
        strokes.read(file)


def test_entities_do_not_grow(tmp_path: Path) -> None:
    file = tmp_path / "drawing.svg"
    entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 10))
    file.write_text(
        f'<!DOCTYPE svg [<!ENTITY e0 "lol">{entities}]>' + HEAD.format("", "<text>&e9;</text>"), encoding="utf-8"
    )
    with pytest.raises(FiveBarError, match="it is no XML"):
        strokes.read(file)
