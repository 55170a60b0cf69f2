"""Drawings as strokes of a pen: the shapes of an SVG, whatever their colours, or the rows of a CSV.

A stroke is a chain of cubic Bézier curves, shape (n, 4, 2), in m, y upwards; lines are such curves too. Lengths of a drawing are in mm
unless it says otherwise: an SVG by the units of its width and height, a CSV by its header, as in `x [m],y [m],pen`.
"""

import csv
import io
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from svgelements import SVG, Arc, Close, CubicBezier, Image, Matrix, Move, QuadraticBezier, Shape, Text
from svgelements import Path as Outline

from fivebar.errors import FiveBarError

Floats = NDArray[np.float64]

LARGEST = 10_000_000
"""Bytes of a drawing, at most."""

MOST_CURVES = 100_000
"""Curves of a drawing, at most."""

MM = 1e-3

PIXELS_PER_INCH = 1 / 0.0393701
"""Makes a millimetre of svgelements, which takes 0.0393701 of them for an inch, one user unit exactly."""

ARC = np.pi / 16
"""Largest angle of an arc that one cubic curve stands for: it is off by 1e-8 of the radius."""

ROUND_OFF = 1e-12
"""Size of a curve, in multiples of its largest coordinate, below which it is a point."""

NEVER_DRAWN = ("clipPath", "defs", "linearGradient", "marker", "mask", "pattern", "radialGradient", "symbol")
"""Elements whose children are drawn by reference only."""

COMMANDS = re.compile(r"[\sMmZzLlHhVvCcSsQqTtAaEe0-9+\-.,]*")
"""The characters of path data; `e` in numbers."""

UNITS = {"m": 1.0, "cm": 1e-2, "mm": MM, "in": 25.4e-3}
"""Units that the header of a CSV may name, in m."""


@dataclass(frozen=True)
class Drawing:
    """Strokes that a pen is to draw."""

    strokes: list[Floats]
    """Cubic curves, m, shape (n, 4, 2) each; a curve begins where the one before it ends."""

    left_out: tuple[str, ...] = ()
    """Sentences on what the file has beside strokes."""

    @property
    def box(self) -> Floats:
        """Lower left and upper right corner, m, shape (2, 2): of the curves, to 1e-3 of the drawing's size."""
        points = np.concatenate([points_of(stroke, 16).reshape(-1, 2) for stroke in self.strokes])
        return np.stack([points.min(axis=0), points.max(axis=0)])

    def placed(self, at: tuple[float, float], width: float | None = None) -> "Drawing":
        """The drawing with the middle of its box at a place, m, and scaled to a width, m, if one is told."""
        low, high = self.box
        extent = high - low
        # A drawing without width, as a vertical line, is as wide as it is high.
        scale = 1.0 if width is None else width / float(extent[0] if extent[0] > 0 else extent[1])
        middle = (low + high) / 2
        return replace(self, strokes=[np.array(at) + scale * (stroke - middle) for stroke in self.strokes])


def points_of(curves: Floats, count: int) -> Floats:
    """Points of curves (n, 4, 2) at `count` + 1 even parameters: shape (n, count + 1, 2)."""
    u = np.linspace(0, 1, count + 1)[:, None]
    weights = np.concatenate([(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u**2 * (1 - u), u**3], axis=1)
    return np.einsum("ui,nik->nuk", weights, curves)


def read(file: str | Path) -> Drawing:
    """The drawing in an .svg or .csv. Raises FiveBarError, with one sentence, if there is none in it."""
    path = Path(file)
    kinds = {".svg": _svg, ".csv": _csv}
    if path.suffix.lower() not in kinds:
        raise FiveBarError(f"{path}: a drawing is an .svg or a .csv, not {path.suffix or 'a file without ending'}")
    try:
        with path.open("rb") as stream:
            content = stream.read(LARGEST + 1)
    except OSError as error:
        raise FiveBarError(f"{path} cannot be read: {error.strerror}") from None
    if len(content) > LARGEST:
        raise FiveBarError(f"{path} has more than {LARGEST} bytes")
    try:
        drawing = kinds[path.suffix.lower()](content)
    except FiveBarError as error:
        raise FiveBarError(f"{path}: {error}") from None
    if not drawing.strokes:
        also = " ".join(("", *drawing.left_out))
        raise FiveBarError(f"{path} has no line to draw.{also}")
    if (count := sum(map(len, drawing.strokes))) > MOST_CURVES:
        raise FiveBarError(f"{path} has {count} curves; {MOST_CURVES} are allowed")
    return drawing


# SVG


def _svg(content: bytes) -> Drawing:
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, UnicodeDecodeError, LookupError) as error:
        raise FiveBarError(f"it is no XML: {error}") from None
    if _name(root) != "svg":
        raise FiveBarError(f"its first element is <{_name(root)}>, not <svg>")
    for element in root.iter():
        data = element.get("d", "") if _name(element) == "path" else ""
        if not COMMANDS.fullmatch(data):
            wrong = data[COMMANDS.match(data).end()]  # type: ignore[union-attr]
            raise FiveBarError(f"a path's data have {wrong!r}, which is no command: {data[:60]!r}")
    left_out = _leave_out_symbols(root)
    _complete_size(root)
    try:
        svg = SVG.parse(io.BytesIO(ElementTree.tostring(root)), reify=False, ppi=PIXELS_PER_INCH)
    except (ValueError, TypeError, AttributeError, KeyError, IndexError, ZeroDivisionError, RecursionError) as error:
        raise FiveBarError(f"svgelements cannot read it: {type(error).__name__}: {error}") from None
    strokes: list[Floats] = []
    for element in svg.elements():
        if isinstance(element, Shape):
            strokes += _of_shape(element)
        elif isinstance(element, Text):
            left_out.append(f"The text {str(element.text)[:40]!r} is left out: only its outline can be drawn (Inkscape: Object to Path).")
        elif isinstance(element, Image):
            left_out.append("An image is left out: only lines can be drawn.")
    return Drawing(strokes, tuple(left_out))


def _name(element: ElementTree.Element) -> str:
    """The name of an element without its namespace; comments have none."""
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _leave_out_symbols(root: ElementTree.Element) -> list[str]:
    """Takes out what is drawn by reference only, but <defs>: svgelements would draw it in place, and refers to shapes and groups alone."""
    symbols = {f"#{element.get('id')}" for element in root.iter() if _name(element) == "symbol"}
    used = [element for element in root.iter() if _name(element) == "use"]
    sentences = [
        f"A <use> of the symbol {target} is left out."
        for target in sorted({value for element in used for key, value in element.items() if key.rpartition("}")[2] == "href"} & symbols)
    ]
    for parent in list(root.iter()):
        for child in list(parent):
            if _name(child) in NEVER_DRAWN and _name(child) != "defs":
                parent.remove(child)
    return sentences


def _complete_size(root: ElementTree.Element) -> None:
    """Gives a root with a viewBox both width and height: one that is missing keeps the shape (CSS 2.1, section 10.4)."""
    box = root.get("viewBox", "").replace(",", " ").split()
    given = {name: root.get(name) for name in ("width", "height")}
    given = {name: value for name, value in given.items() if value and value != "auto" and not value.strip().endswith("%")}
    if len(box) != 4 or len(given) == 2:
        return
    try:
        wide, high = float(box[2]), float(box[3])
    except ValueError:
        raise FiveBarError(f"its viewBox is {root.get('viewBox')!r}: it must be four numbers") from None
    if not (wide > 0 and high > 0):
        raise FiveBarError(f"its viewBox is {root.get('viewBox')!r}: width and height must be positive")
    if not given:
        root.set("width", box[2])
        root.set("height", box[3])
        return
    (known, value), share = next(iter(given.items())), {"width": high / wide, "height": wide / high}
    if number := re.fullmatch(r"\s*([+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?)\s*([a-zA-Z]*)\s*", value or ""):
        root.set("height" if known == "width" else "width", f"{float(number[1]) * share[known]!r}{number[2]}")


def _of_shape(shape: Shape) -> list[Floats]:
    """Strokes of a shape: its curves, then transformed, because arcs are no arcs any more where a transform skews them."""
    strokes: list[Floats] = []
    curves: list[list[complex]] = []
    for segment in Outline(shape).segments(transformed=False):
        if isinstance(segment, Move):
            strokes += _stroke(curves, shape.transform)
            curves = []
        else:
            curves += _cubics(segment)
    return strokes + _stroke(curves, shape.transform)


def _cubics(segment: object) -> list[list[complex]]:
    """Cubic curves of a segment, each by four points."""
    if isinstance(segment, Arc):
        parts = max(1, int(np.ceil(abs(float(segment.sweep)) / ARC)))
        return [[complex(p) for p in (c.start, c.control1, c.control2, c.end)] for c in segment.as_cubic_curves(parts)]
    start, end = complex(segment.start), complex(segment.end)  # type: ignore[attr-defined]
    if isinstance(segment, CubicBezier):
        return [[start, complex(segment.control1), complex(segment.control2), end]]
    if isinstance(segment, QuadraticBezier):
        control = complex(segment.control)
        return [[start, start + 2 / 3 * (control - start), end + 2 / 3 * (control - end), end]]
    assert isinstance(segment, Close) or type(segment).__name__ == "Line"
    return [[start, (2 * start + end) / 3, (start + 2 * end) / 3, end]]


def _stroke(curves: list[list[complex]], transform: Matrix) -> list[Floats]:
    """A stroke in m with y upwards, or none if it has no length."""
    points = np.array(curves, dtype=complex).reshape(-1, 4)
    x, y = points.real, points.imag
    with np.errstate(over="ignore", invalid="ignore"):
        moved = np.stack([transform.a * x + transform.c * y + transform.e, transform.b * x + transform.d * y + transform.f], axis=-1)
    if not np.all(np.isfinite(moved)):
        raise FiveBarError("a point of it is not finite")
    return _without_points(moved * (MM, -MM))


def _without_points(stroke: Floats) -> list[Floats]:
    """The stroke without curves that are points but for round-off, or nothing if all are."""
    if not len(stroke):
        return []
    sizes = np.abs(stroke - stroke[:, :1]).max(axis=(1, 2))
    stroke = stroke[sizes > ROUND_OFF * np.abs(stroke).max()]
    return [stroke] if len(stroke) else []


# CSV


def _csv(content: bytes) -> Drawing:
    try:
        rows = [row for row in csv.reader(io.StringIO(content.decode("utf-8-sig"))) if any(cell.strip() for cell in row)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise FiveBarError(f"it is no CSV: {error}") from None
    scale = MM
    if rows and not _is_number(rows[0][0]):
        scale, rows = _unit_of(rows[0]), rows[1:]
    table = []
    for number, row in enumerate(rows, 1):
        if len(row) not in (2, 3) or not all(map(_is_number, row)) or (len(row) == 3 and float(row[2]) not in (0, 1)):
            raise FiveBarError(f"row {number} is {','.join(row)!r}: it must be x,y or x,y,pen, with pen 1 on the way there or 0")
        table.append((float(row[0]), float(row[1]), float(row[2]) if len(row) == 3 else 1.0))
    strokes, begin = [], 0
    points = np.array(table).reshape(-1, 3)
    lifted = [*np.flatnonzero(points[1:, 2] == 0) + 1, len(points)]
    for end in lifted:
        chain = points[begin:end, :2] * scale
        strokes += _without_points(chain[:-1, None] + np.linspace(0, 1, 4)[:, None] * np.diff(chain, axis=0)[:, None])
        begin = end
    return Drawing(strokes)


def _unit_of(header: list[str]) -> float:
    """The unit of a header's columns, in m."""
    found = [re.fullmatch(r"\s*([a-z.]+)\s*(?:\[(\w+)\])?\s*", cell) for cell in header]
    names = [match[1].removeprefix("tip.") if match else None for match in found]
    units = {match[2] or "mm" for match in found[:2] if match}
    if names not in (["x", "y"], ["x", "y", "pen"]) or len(units) != 1 or not units <= set(UNITS):
        raise FiveBarError(f"its header is {','.join(header)!r}: it must be as 'x [mm],y [mm],pen', with one of the units {', '.join(UNITS)}")
    return UNITS[units.pop()]


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False
