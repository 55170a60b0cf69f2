"""Reads the lines of an SVG: elements, units, styles, references and transforms. svgelements reads path data and colours.

The effort is bounded: elements, strokes and curves are counted before they are processed, including the repetitions by `<use>`.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from operator import itemgetter
from typing import Any, NamedTuple, NoReturn
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from svgelements import (
    Arc,
    Circle,
    Close,
    Color,
    CubicBezier,
    Ellipse,
    Move,
    Polygon,
    Polyline,
    QuadraticBezier,
    Rect,
    Shape,
    SimpleLine,
)
from svgelements import Path as Outline

from fivebar.errors import FiveBarError

Floats = NDArray[np.float64]
Element = ElementTree.Element

PX = 25.4 / 96
"""Size of a CSS pixel, mm."""

UNITS = {"mm": 1.0, "cm": 10.0, "in": 25.4, "Q": 0.25, "pt": 25.4 / 72, "pc": 25.4 / 6, "px": PX}
"""The absolute units of CSS, in mm; upper and lower case are equivalent."""

FACTORS = {unit.lower(): factor for unit, factor in UNITS.items()}

ANGLES = {"": 1.0, "deg": 1.0, "rad": 180 / np.pi, "grad": 0.9, "turn": 360.0}
"""Units of angles, in degrees."""

ARC = np.pi / 16
"""Largest angle of an arc per cubic curve: the error is 1e-8 of the radius."""

MOST_ELEMENTS = 100_000
"""Largest number of elements, including repetitions by `<use>`."""

MOST_CHARACTERS = 10_000_000
"""Largest number of characters in their attributes."""

MOST_ARCS = 30_000
"""Largest number of arcs in path data: svgelements needs some 50 us for one, ten times as long as for a line."""

MOST_DEPTH = 200
"""Largest depth of nested elements, including references by `<use>`: far below Python's recursion limit."""

MOST_REMARKS = 20
"""Largest number of sentences on parts that are left out."""

SVG = "{http://www.w3.org/2000/svg}"
SHAPES = ("path", "rect", "circle", "ellipse", "line", "polyline", "polygon")
CONTAINERS = ("svg", "g", "a", "switch", "use")

INHERITED = {
    "color": "black",
    "visibility": "visible",
    "fill": "black",
    "fill-opacity": "1",
    "stroke": "none",
    "stroke-opacity": "1",
    "stroke-width": "1",
}
"""Properties that children inherit from their parents, with initial values."""

LEFT_OUT = {
    "clip-path": "The clip path",
    "mask": "The mask",
    "marker-start": "The marker",
    "marker-mid": "The marker",
    "marker-end": "The marker",
    "stroke-dasharray": "The dash pattern",
}
"""Properties that change the appearance of a line, with their names in messages."""

NUMBER = r"[+-]?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][+-]?\d++)?"
SEPARATOR = r"\s*+,?\s*+"
LENGTH = re.compile(rf"\s*({NUMBER})\s*(%|[a-zA-Z]*)\s*")
FLEXIBLE = re.compile(rf"\s*(?:auto|{NUMBER}\s*%)?\s*")
"""A relative size, which does not determine the size of a page."""

TRANSFORM = re.compile(r"[\s,]*([a-zA-Z]+)\s*\(([^()]*)\)[\s,]*")

COMMANDS = re.compile(r"[\sMmZzLlHhVvCcSsQqTtAaEe0-9+\-.,]*")
"""Characters of path data; `e` occurs in numbers."""

ARGUMENTS = {
    **{
        command: re.compile(rf"(?:{SEPARATOR}{NUMBER}){{{count}}}")
        for command, count in zip("mlhvcsqt", (2, 2, 1, 1, 6, 4, 4, 2))
    },
    "a": re.compile(rf"(?:{SEPARATOR}{NUMBER}){{3}}(?:{SEPARATOR}[01]){{2}}(?:{SEPARATOR}{NUMBER}){{2}}"),
}
"""Pattern of one group of arguments, for each path command with arguments."""

FUNCTIONS = {
    "matrix": (6,),
    "translate": (1, 2),
    "translateX": (1,),
    "translateY": (1,),
    "scale": (1, 2),
    "scaleX": (1,),
    "scaleY": (1,),
    "rotate": (1, 3),
    "skewX": (1,),
    "skewY": (1,),
}
"""Functions of a transform, and their allowed numbers of arguments."""

PLACES = {"left": "0%", "top": "0%", "center": "50%", "right": "100%", "bottom": "100%"}
"""Keywords of a transform's origin."""

Style = dict[str, str]


class _Frame(NamedTuple):
    """Coordinate system of an element on the page."""

    matrix: Floats
    """Matrix from user units to mm, shape (3, 3), y downwards."""

    viewport: tuple[float | None, float | None]
    """Width and height of the nearest <svg>, user units, as the reference of percentages; None if the page has no size."""

    inherited: Style
    within: tuple[Element, ...] = ()
    """The enclosing elements, including each <use> on the way."""


_Planned = tuple[Element, Callable[[], Shape], Floats]
"""An element, the function that makes its shape, and the matrix from its user units to mm."""


def read(content: bytes, most_strokes: int, most_curves: int) -> tuple[list[Floats], tuple[str, ...]]:
    """Strokes as cubic curves (n, 4, 2) in mm, y downwards, and sentences on units and on parts that are left out."""
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FiveBarError(f"it is no XML: {error}") from None
    if _name(root) != "svg":
        raise FiveBarError(f"its first element is <{root.tag}>, not <svg>")
    document = _Document(root, most_strokes, most_curves)
    strokes = list(document.strokes())
    return strokes, document.remarks()


def _name(element: Element) -> str:
    """The name of an SVG element without namespace; "" for comments and elements of other namespaces."""
    tag = element.tag if isinstance(element.tag, str) else "{}"
    return tag.removeprefix(SVG) if tag.startswith(SVG) or "{" not in tag else ""


class _Document:
    """An SVG, and the state of reading it."""

    def __init__(self, root: Element, most_strokes: int, most_curves: int):
        self.root = root
        self.most = {
            "elements": MOST_ELEMENTS,
            "characters": MOST_CHARACTERS,
            "arcs": MOST_ARCS,
            "strokes": most_strokes,
            "curves": most_curves,
        }
        self.spent: Counter[str] = Counter()
        # A file with too many elements is refused before their styles are read, which takes most of the time.
        if sum(_name(element) in (*CONTAINERS, *SHAPES) for element in root.iter()) > MOST_ELEMENTS:
            self._refuse("elements")
        self.said: dict[str, None] = {}
        self.hidden = ""
        """A sentence on hidden elements, or ""."""
        self.css = _Sheet(root, self.said)
        # If several elements have the same id, browsers use the first.
        self.named = {identity: element for element in reversed([*root.iter()]) if (identity := element.get("id"))}
        self.unit = 1.0
        """Size of a user unit of the page without viewBox, mm; 1 if the page has no units."""

    def remarks(self) -> tuple[str, ...]:
        """Sentences on units and on parts that are left out."""
        said = [*self.said, *filter(None, [self.hidden])]
        return tuple(
            said
            if len(said) <= MOST_REMARKS
            else [*said[:MOST_REMARKS], f"{len(said) - MOST_REMARKS} other things are left out."]
        )

    def strokes(self) -> Iterator[Floats]:
        """All strokes; call it once. All shapes are counted before the first is made."""
        for element, make, matrix in list(self._drawn(self.root, _Frame(np.eye(3), (None, None), INHERITED))):
            yield from self._of_shape(element, make, matrix)

    def _spend(self, what: str, count: int = 1) -> None:
        self.spent[what] += count
        if self.spent[what] > self.most[what]:
            self._refuse(what)

    def _refuse(self, what: str) -> NoReturn:
        raise FiveBarError(f"it has more than {self.most[what]} {what}, including repetitions by <use>")

    # Elements

    def _drawn(self, element: Element, frame: _Frame) -> Iterator[_Planned]:
        """Shapes of an element and of its children."""
        name = _name(element)
        if name not in (*CONTAINERS, *SHAPES):
            self._leave_out(element, name)
            return
        self._spend("elements")
        self._spend("characters", sum(map(len, element.attrib.values())))
        if len(frame.within) >= MOST_DEPTH:
            raise FiveBarError(f"elements are nested more than {MOST_DEPTH} deep")
        if element in frame.within:
            raise FiveBarError(f"{_called(element)} is drawn within itself, by <use>")
        style = self.css.style(element)
        inherited = {
            key: style[key] if style.get(key, "inherit") != "inherit" else value
            for key, value in frame.inherited.items()
        }
        if _word(style, "display") == "none" or _is_zero(style.get("opacity", "1")):
            self._hide(element)
            return
        for key in LEFT_OUT.keys() & style.keys():
            if _word(style, key) not in ("none", "", "inherit"):
                self.said[f"{LEFT_OUT[key]} of {_called(element)} is left out: lines are drawn whole."] = None
        frame = _Frame(frame.matrix, frame.viewport, inherited, (*frame.within, element))
        if element is self.root:
            frame = self._page(element, style, frame)
        else:
            frame = frame._replace(matrix=frame.matrix @ self._transform(element, style, frame))
            if name == "svg":
                frame = self._nested(element, style, frame)
                if 0.0 in frame.viewport:
                    self._hide(element)
                    return
        if name in SHAPES:
            if not _is_visible(inherited):
                self._hide(element)
                return
            if (make := self._shape(element, name, style, frame)) is not None:
                yield element, make, frame.matrix
        elif name == "use":
            yield from self._used(element, style, frame)
        else:
            for child in self._chosen(element) if name == "switch" else element:
                yield from self._drawn(child, frame)

    def _leave_out(self, element: Element, name: str) -> None:
        """Reports an element that cannot be drawn, unless it is a definition or a description."""
        if name == "text":
            text = next((part.strip() for part in element.itertext() if part.strip()), "")
            self.said[
                f"The text {text[:40]!r} is left out: only its outline can be drawn (Inkscape: Object to Path)."
            ] = None
        elif name == "image":
            self.said["An image is left out: only lines can be drawn."] = None
        elif name == "foreignObject":
            self.said["A <foreignObject> is left out: only lines can be drawn."] = None

    def _hide(self, element: Element) -> None:
        if not self.hidden:
            self.hidden = (
                f"Hidden elements are not drawn, such as {_called(element)} "
                "(display, visibility, opacity, no size, or neither fill nor stroke)."
            )

    def _used(self, element: Element, style: Style, frame: _Frame) -> Iterator[_Planned]:
        """Shapes of the element to which a <use> refers."""
        target = next((value for key, value in element.items() if key.rpartition("}")[2] == "href"), "")
        used = self.named.get(target.removeprefix("#")) if target.startswith("#") else None
        if used is None:
            self.said[f"A <use> of {target!r:.60} is left out: no element of the drawing has that id."] = None
        elif _name(used) == "symbol":
            self.said[f"A <use> of the symbol {target} is left out."] = None
        else:
            x, y = (self._length(element, style, name, frame, axis) or 0.0 for axis, name in enumerate("xy"))
            yield from self._drawn(used, frame._replace(matrix=frame.matrix @ _moved(x, y)))

    def _chosen(self, element: Element) -> list[Element]:
        """The first child of a <switch> that requires no extension and no other language than English."""
        for child in element:
            languages = [language.strip() for language in child.get("systemLanguage", "en").split(",")]
            if (
                _name(child)
                and not child.get("requiredExtensions")
                and any(language.partition("-")[0] == "en" for language in languages)
            ):
                return [child]
        self.said["A <switch> is left out: each of its children asks for an extension or another language."] = None
        return []

    # Units

    def _length(
        self, element: Element, style: Style, name: str, frame: _Frame, axis: int | None, least: float = -np.inf
    ) -> float | None:
        """A length in user units, or None if it is not given. Percentages refer to axis 0 or 1, or to the diagonal (None)."""
        text = style.get(name)
        if text is None or text == "auto":
            return None
        wide, high = frame.viewport
        diagonal = None if wide is None or high is None else float(np.hypot(wide, high) / np.sqrt(2))
        share = diagonal if axis is None else frame.viewport[axis]
        value = self._measure(f"<{_name(element)}> has {name}={text!r:.60}", text, share)
        if not value >= least:
            raise FiveBarError(f"<{_name(element)}> has {name}={text!r:.60}: it must not be less than {least:g}")
        return value

    def _measure(self, what: str, text: str, share: float | None) -> float:
        """A length in user units; percentages refer to the length `share`."""
        match = LENGTH.fullmatch(text)
        unit = match[2].lower() if match else ""
        if match is None or unit not in ("", "%", *FACTORS) or not np.isfinite(float(match[1])):
            raise FiveBarError(
                f"{what}: it must be a number, without a unit or in {', '.join(UNITS)} or %, such as 100.5mm"
            )
        if unit == "%":
            if share is None:
                raise FiveBarError(f"{what}: the page has no size to which the percentage could refer")
            return float(match[1]) / 100 * share
        if unit == "px":
            self._say_px()
        return float(match[1]) * (FACTORS[unit] / self.unit if unit else 1.0)

    def _say_px(self) -> None:
        self.said["Its px are 25.4/96 mm (CSS)."] = None

    def _page(self, root: Element, style: Style, frame: _Frame) -> _Frame:
        """The frame of the root's children; width and height of the root determine the units.

        If one of the two is missing, it follows from the aspect ratio of the viewBox (CSS 2.1, section 10.4).
        """
        # A style such as width:100% only fits the page into a window; the attribute has the size.
        given = {name: (style.get(name, ""), root.get(name, "")) for name in ("width", "height")}
        sizes = {name: [text.strip() for text in both if not FLEXIBLE.fullmatch(text)] for name, both in given.items()}
        texts = {name: found[0] for name, found in sizes.items() if found}
        if any(re.search(r"[a-zA-Z]\s*$", text) for text in texts.values()):
            self.unit = PX
        size = {name: self._measure(f"<svg> has {name}={text!r:.60}", text, None) for name, text in texts.items()}
        for name, value in size.items():
            if not value > 0:
                raise FiveBarError(f"<svg> has {name}={texts[name]!r:.60}: it must be positive")
        box = self._view_box(root)
        if box is None and self.unit == PX:
            self._say_px()
        if box is not None:
            known = next(
                (size[name] / extent for name, extent in (("width", box[2]), ("height", box[3])) if name in size), 1.0
            )
            size = {"width": size.get("width", known * box[2]), "height": size.get("height", known * box[3])}
        frame = frame._replace(
            matrix=np.diag([self.unit, self.unit, 1.0]), viewport=(size.get("width"), size.get("height"))
        )
        return self._within_box(root, frame._replace(matrix=frame.matrix @ self._transform(root, style, frame)), box)

    def _nested(self, element: Element, style: Style, frame: _Frame) -> _Frame:
        """The frame of the children of an <svg> inside the root."""
        x, y = (self._length(element, style, name, frame, axis) or 0.0 for axis, name in enumerate("xy"))
        # The size of a <use> that refers to it has priority over its own.
        outer = frame.within[-2]
        size = self._size(element, style, frame)
        if _name(outer) == "use":
            size = [
                own if computed is None else computed
                for computed, own in zip(self._size(outer, self.css.style(outer), frame), size)
            ]
        width, height = (known if computed is None else computed for computed, known in zip(size, frame.viewport))
        frame = frame._replace(matrix=frame.matrix @ _moved(x, y), viewport=(width, height))
        if 0.0 in frame.viewport:
            return frame
        return self._within_box(element, frame, self._view_box(element))

    def _size(self, element: Element, style: Style, frame: _Frame) -> list[float | None]:
        return [self._length(element, style, name, frame, axis, 0.0) for axis, name in enumerate(("width", "height"))]

    def _view_box(self, element: Element) -> Floats | None:
        text = element.get("viewBox")
        if text is None:
            return None
        parts = text.replace(",", " ").split()
        if (
            len(parts) != 4
            or not all(re.fullmatch(NUMBER, part) for part in parts)
            or not np.all(np.isfinite(box := np.array(parts, dtype=np.float64)))
        ):
            raise FiveBarError(f"its viewBox is {text!r:.60}: it must be four numbers")
        if not (box[2] > 0 and box[3] > 0):
            raise FiveBarError(f"its viewBox is {text!r:.60}: width and height must be positive")
        return box

    def _within_box(self, element: Element, frame: _Frame, box: Floats | None) -> _Frame:
        """The frame of an element's content: its viewBox mapped onto the viewport as preserveAspectRatio says."""
        if box is None:
            return frame
        wide, high = frame.viewport
        if wide is None or high is None:
            raise FiveBarError("an <svg> with a viewBox has neither width nor height, and the page has no size")
        text = element.get("preserveAspectRatio", "xMidYMid meet")
        match = re.fullmatch(r"\s*(?:defer\s+)?(?:(none)|x(Min|Mid|Max)Y(Min|Mid|Max))(?:\s+(meet|slice))?\s*", text)
        if match is None:
            raise FiveBarError(f"<svg> has preserveAspectRatio={text!r:.60}: it must be none, or as 'xMidYMid meet'")
        viewport = np.array([wide, high])
        scale = viewport / box[2:]
        if not match[1]:
            scale[:] = scale.max() if match[4] == "slice" else scale.min()
        share = np.array([{"Min": 0.0, "Mid": 0.5, "Max": 1.0}.get(match[i], 0.0) for i in (2, 3)])
        shift = share * (viewport - scale * box[2:]) - scale * box[:2]
        return frame._replace(
            matrix=frame.matrix @ _moved(*shift) @ np.diag([*scale, 1.0]), viewport=(float(box[2]), float(box[3]))
        )

    # Transforms

    def _transform(self, element: Element, style: Style, frame: _Frame) -> Floats:
        """The matrix of an element's transform about its origin."""
        text = style.get("transform", "none").strip()
        if text in ("", "none"):
            return np.eye(3)
        what = f"<{_name(element)}> has transform={text!r:.60}"
        matrix, end = np.eye(3), 0
        for match in TRANSFORM.finditer(text):
            if match.start() != end:
                break
            matrix, end = matrix @ self._function(what, match[1], match[2], frame), match.end()
        if end != len(text):
            raise FiveBarError(f"{what}: it must be a list of functions, such as translate(10 5) rotate(30)")
        origin = style.get("transform-origin", "0 0").split()
        if _word(style, "transform-box") not in ("", "view-box") and "transform-origin" in style:
            raise FiveBarError(
                f"<{_name(element)}> has transform-box={style['transform-box']!r:.60}: "
                "with transform-origin, only view-box is allowed"
            )
        if len(origin) == 1:
            origin.append("center")
        if origin[0] in ("top", "bottom") or origin[1] in ("left", "right"):
            origin[:2] = origin[1], origin[0]
        about = f"<{_name(element)}> has transform-origin={style.get('transform-origin')!r:.60}"
        x, y = (self._measure(about, PLACES.get(part, part), share) for part, share in zip(origin, frame.viewport))
        return _moved(x, y) @ matrix @ _moved(-x, -y)

    def _function(self, what: str, name: str, inside: str, frame: _Frame) -> Floats:
        texts = [part for part in re.split(r"\s*,\s*|\s+", inside.strip()) if part]
        if name not in FUNCTIONS:
            raise FiveBarError(f"{what}: {name} is none of {', '.join(FUNCTIONS)}")
        if len(texts) not in FUNCTIONS[name]:
            raise FiveBarError(
                f"{what}: {name} must have {' or '.join(map(str, FUNCTIONS[name]))} arguments, not {len(texts)}"
            )
        if name.startswith("translate"):
            shares = frame.viewport[::-1] if name == "translateY" else frame.viewport
            found = [self._measure(what, text, share) for text, share in zip(texts, shares)]
        else:
            angled = name in ("rotate", "skewX", "skewY")
            found = [_number(what, text, ANGLES if angled and i == 0 else {"": 1.0}) for i, text in enumerate(texts)]
        first = found[0]
        if name == "matrix":
            a, b, c, d, e, f = found
            return np.array([[a, c, e], [b, d, f], [0, 0, 1]])
        if name.startswith("translate"):
            return _moved(0.0, first) if name == "translateY" else _moved(first, found[1] if len(found) == 2 else 0.0)
        if name.startswith("scale"):
            second = found[1] if len(found) == 2 else first
            return np.diag([1.0 if name == "scaleY" else first, 1.0 if name == "scaleX" else second, 1.0])
        angle = np.deg2rad(first)
        if name != "rotate":
            skew = np.eye(3)
            skew[(0, 1) if name == "skewX" else (1, 0)] = np.tan(angle)
            return skew
        x, y = found[1:] or (0.0, 0.0)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        about: Floats = _moved(x, y) @ turn @ _moved(-x, -y)
        return about

    # Shapes

    def _shape(self, element: Element, name: str, style: Style, frame: _Frame) -> Callable[[], Shape] | None:
        """Counts the curves of a shape and returns a function that makes it in user units; None if the shape is empty."""

        def length(key: str, axis: int | None, least: float = -np.inf) -> float | None:
            return self._length(element, style, key, frame, axis, least)

        if name == "path":
            data = style.get("d", "").strip()
            self._count(data)
            return partial(Outline, data) if data not in ("", "none") else None
        self._spend("strokes")
        if name in ("polyline", "polygon"):
            text = element.get("points", "")
            if not re.fullmatch(rf"(?:{SEPARATOR}{NUMBER}{SEPARATOR}{NUMBER})*+\s*", text):
                raise FiveBarError(f"<{name}> has points={text!r:.60}: they must be pairs of numbers")
            numbers = [float(number) for number in re.findall(NUMBER, text)]
            self._spend("curves", len(numbers) // 2)
            return (
                partial(Polygon if name == "polygon" else Polyline, *zip(numbers[::2], numbers[1::2]))
                if numbers
                else None
            )
        if name == "line":
            self._spend("curves")
            return partial(
                SimpleLine, *(length(key, axis) or 0.0 for key, axis in (("x1", 0), ("y1", 1), ("x2", 0), ("y2", 1)))
            )
        if name == "rect":
            x, y, rx, ry = (
                length(key, axis, least)
                for key, axis, least in (("x", 0, -np.inf), ("y", 1, -np.inf), ("rx", 0, 0), ("ry", 1, 0))
            )
            width, height = length("width", 0, 0) or 0.0, length("height", 1, 0) or 0.0
            rx, ry = (ry if rx is None else rx) or 0.0, (rx if ry is None else ry) or 0.0
            self._spend("curves", 9 if rx and ry else 4)
            return (
                partial(Rect, x or 0.0, y or 0.0, width, height, min(rx, width / 2), min(ry, height / 2))
                if width > 0 and height > 0
                else None
            )
        # Four arcs and the closing line.
        self._spend("curves", 5)
        cx, cy = length("cx", 0) or 0.0, length("cy", 1) or 0.0
        if name == "circle":
            radius = length("r", None, 0) or 0.0
            return partial(Circle, cx, cy, radius) if radius > 0 else None
        rx, ry = length("rx", 0, 0), length("ry", 1, 0)
        rx, ry = (ry if rx is None else rx) or 0.0, (rx if ry is None else ry) or 0.0
        return partial(Ellipse, cx, cy, rx, ry) if rx > 0 and ry > 0 else None

    def _count(self, data: str) -> None:
        """Refuses invalid path data, and counts its curves before they are made."""
        if data == "none":
            return
        if not COMMANDS.fullmatch(data):
            wrong = data[COMMANDS.match(data).end()]  # type: ignore[union-attr]
            raise FiveBarError(f"a path's data have {wrong!r}, which is no command: {data[:60]!r}")
        if data and data[0] not in "Mm":
            raise FiveBarError(f"a path's data begin with {data[0]!r}, but must begin with M: {data[:60]!r}")
        at = 0
        while at < len(data):
            command, at = data[at], at + 1
            count = 0
            if command not in "Zz":
                group = ARGUMENTS.get(command.lower())
                while group is not None and (match := group.match(data, at)):
                    count, at = count + 1, match.end()
                    self._spend("strokes" if command in "Mm" and count == 1 else "curves")
                    if command in "Aa":
                        self._spend("arcs")
                if count == 0:
                    raise FiveBarError(
                        f"a path's data have {data[at - 1 : at + 30]!r}, which is no command with its numbers: "
                        f"{data[:60]!r}"
                    )
            else:
                self._spend("curves")
            while at < len(data) and data[at].isspace():
                at += 1

    def _of_shape(self, element: Element, make: Callable[[], Shape], matrix: Floats) -> Iterator[Floats]:
        """Strokes of a shape. Arcs become cubic curves before the transform, since a skewed arc is no longer an arc."""
        try:
            segments = list(Outline(make()).segments(transformed=False))
            parts = [
                max(1, int(np.ceil(abs(float(each.sweep)) / ARC))) if isinstance(each, Arc) else 1 for each in segments
            ]
        except (ValueError, TypeError, AttributeError, IndexError, ArithmeticError) as error:
            raise FiveBarError(
                f"svgelements makes no lines of {_called(element)} with {element.attrib!s:.80}: "
                f"{type(error).__name__}: {error}"
            ) from None
        self._spend("curves", sum(parts) - len(parts))
        curves: list[list[complex]] = []
        for segment, count in zip(segments, parts):
            if isinstance(segment, Move):
                yield from _stroke(curves, matrix)
                curves = []
            elif isinstance(segment, Arc):
                curves += [
                    [complex(p) for p in (c.start, c.control1, c.control2, c.end)]
                    for c in segment.as_cubic_curves(count)
                ]
            else:
                curves.append(_cubic(segment))
        yield from _stroke(curves, matrix)


def _cubic(segment: Any) -> list[complex]:
    """The cubic curve of a segment as four points."""
    start, end = complex(segment.start), complex(segment.end)
    if isinstance(segment, CubicBezier):
        return [start, complex(segment.control1), complex(segment.control2), end]
    if isinstance(segment, QuadraticBezier):
        control = complex(segment.control)
        return [start, start + 2 / 3 * (control - start), end + 2 / 3 * (control - end), end]
    assert isinstance(segment, Close) or type(segment).__name__ == "Line"
    return [start, (2 * start + end) / 3, (start + 2 * end) / 3, end]


def _stroke(curves: list[list[complex]], matrix: Floats) -> list[Floats]:
    """A list with the stroke in mm; empty if there are no curves."""
    if not curves:
        return []
    points = np.array(curves, dtype=complex)
    with np.errstate(over="ignore", invalid="ignore"):
        moved = np.stack([points.real, points.imag, np.ones(points.shape)], axis=-1) @ matrix[:2].T
    if not np.all(np.isfinite(moved)):
        raise FiveBarError("a point is not finite in mm: coordinates and transforms must be smaller")
    return [moved]


def _moved(x: float, y: float) -> Floats:
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def _number(what: str, text: str, units: dict[str, float]) -> float:
    match = LENGTH.fullmatch(text)
    if match is None or match[2] not in units or not np.isfinite(float(match[1])):
        raise FiveBarError(
            f"{what}: {text!r:.40} must be a finite number{' in deg, rad, grad or turn' if len(units) > 1 else ''}"
        )
    return float(match[1]) * units[match[2]]


def _called(element: Element) -> str:
    identity = element.get("id")
    return f"<{_name(element)}>" if identity is None else f"<{_name(element)} id={identity!r:.40}>"


# Styles


def _word(style: Style, name: str) -> str:
    return style.get(name, "").strip().lower()


def _is_zero(text: str) -> bool:
    match = re.match(rf"\s*({NUMBER})", text)
    return match is not None and float(match[1]) <= 0


def _is_visible(inherited: Style) -> bool:
    """Whether a shape is visible: not hidden, and filled or stroked with a colour that is not transparent."""
    painted = [
        not _is_clear(inherited["color" if _word(inherited, paint) == "currentcolor" else paint])
        and not any(_is_zero(inherited[size]) for size in sizes)
        for paint, sizes in (("fill", ("fill-opacity",)), ("stroke", ("stroke-opacity", "stroke-width")))
    ]
    return _word(inherited, "visibility") not in ("hidden", "collapse") and any(painted)


@lru_cache
def _is_clear(colour: str) -> bool:
    # svgelements does not read the opacity in rgb(0 0 0 / 0).
    if opacity := re.search(r"/\s*([^)]*)\)\s*$", colour):
        return _is_zero(opacity[1])
    try:
        made = Color(colour.strip())
    except (ValueError, TypeError, AttributeError, IndexError):
        # svgelements does not know this colour, so it counts as visible.
        return False
    return made.value is None or made.alpha == 0


class _Sheet:
    """The style sheets of a drawing; selectors of one element, class or id are read."""

    def __init__(self, root: Element, said: dict[str, None]):
        self.rules: dict[str, list[tuple[int, Style]]] = {}
        """Declarations by selector, each with its index in the sheet."""
        self.known: dict[Element, Style] = {}
        text = "".join("".join(element.itertext()) for element in root.iter() if _name(element) == "style")
        text = re.sub(r"/\*.*?\*/|<!--|-->", "", text, flags=re.DOTALL)
        plain = re.sub(r"@[^{};]*+(?:;|\{(?:[^{}]|\{[^{}]*\})*+\})", "", text)
        if "@media" in text:
            said["An @media of the style sheet is left out."] = None
        for place, (selectors, body) in enumerate(re.findall(r"([^{}]+)\{([^{}]*)\}", plain)):
            for selector in map(str.strip, selectors.split(",")):
                if re.fullmatch(r"\*|[\w-]*(?:[.#][\w-]+)?", selector):
                    self.rules.setdefault(selector, []).append((place, _declared(body)))
                else:
                    said[
                        f"The rule {selector[:40]!r} of the style sheet is left out: selectors are read as path, .name, "
                        "path.name or #name."
                    ] = None

    def style(self, element: Element) -> Style:
        """Attributes and properties of an element after the cascade, without inherited properties."""
        if element not in self.known:
            name = _name(element)
            classes = element.get("class", "").split()
            mark = f"#{element.get('id')}"
            by_specificity = (
                ["*"],
                [name],
                [f".{each}" for each in classes],
                [f"{name}.{each}" for each in classes],
                [mark],
                [f"{name}{mark}"],
            )
            levels = []
            for selectors in by_specificity:
                rules = [rule for selector in selectors for rule in self.rules.get(selector, [])]
                levels += [declared for _, declared in sorted(rules, key=itemgetter(0))]
            levels.append(_declared(element.get("style", "")))
            style = dict(element.items())
            for important in (False, True):
                for level in levels:
                    style |= {key: _plain(value) for key, value in level.items() if value.endswith("!") == important}
            self.known[element] = style
        return self.known[element]


def _declared(text: str) -> Style:
    """Declarations `name: value`; values that are `!important` end in `!`."""
    found: Style = {}
    for part in text.split(";"):
        name, colon, value = part.partition(":")
        if colon:
            found[name.strip().lower()] = re.sub(r"\s*!\s*important\s*$", "!", value.strip(), flags=re.IGNORECASE)
    return found


def _plain(value: str) -> str:
    return value.removesuffix("!")
