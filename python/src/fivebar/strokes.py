"""Drawings as strokes of a pen: the shapes of an SVG in any colour, or the rows of a CSV.

A stroke is a chain of cubic Bézier curves, shape (n, 4, 2), in m, y upwards; lines are such curves too. The default unit of a
drawing is mm. An SVG sets another unit by its width and height, a CSV by its header, as in `x [m],y [m],pen`.
"""

import itertools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fivebar import encoding, svg, table
from fivebar.errors import FiveBarError

Floats = NDArray[np.float64]

LARGEST = 10_000_000
"""Largest size of a drawing's file, bytes."""

MOST_STROKES = 10_000
"""Largest number of strokes in a drawing: the rests between so many take more than an hour."""

MOST_CURVES = 100_000
"""Largest number of curves in a drawing."""

MM = 1e-3

ROUND_OFF = 1e-12
"""Size of a curve, in multiples of its largest coordinate, below which it counts as a point."""

UNITS = {"m": 1.0, "cm": 1e-2, "mm": MM, "in": 25.4e-3}
"""Units that the header of a CSV may name, in m."""


@dataclass(frozen=True)
class Drawing:
    """Strokes for a pen."""

    strokes: list[Floats]
    """Chains of cubic curves, m, shape (n, 4, 2) each; every curve begins at the end of the previous one."""

    left_out: tuple[str, ...] = ()
    """Sentences on parts of the file that are left out, and on its units."""

    @property
    def box(self) -> Floats:
        """Bounding box of the curves: lower left and upper right corner, m, shape (2, 2), to 1e-3 of the drawing's size."""
        points = np.concatenate([points_of(stroke, 16).reshape(-1, 2) for stroke in self.strokes])
        return np.stack([points.min(axis=0), points.max(axis=0)])

    def placed(self, at: tuple[float, float], width: float | None = None) -> "Drawing":
        """The drawing with the middle of its box at the point `at`, m, and scaled to `width`, m, if given."""
        low, high = self.box
        extent = high - low
        # For a drawing without width, such as a vertical line, `width` is its height.
        scale = 1.0 if width is None else width / float(extent[0] if extent[0] > 0 else extent[1])
        middle = (low + high) / 2
        return replace(self, strokes=[np.array(at) + scale * (stroke - middle) for stroke in self.strokes])


def points_of(curves: Floats, count: int) -> Floats:
    """Points of curves (n, 4, 2) at `count` + 1 equally spaced parameters, shape (n, count + 1, 2)."""
    u = np.linspace(0, 1, count + 1)[:, None]
    weights = np.concatenate([(1 - u) ** 3, 3 * u * (1 - u) ** 2, 3 * u**2 * (1 - u), u**3], axis=1)
    points: Floats = np.einsum("ui,nik->nuk", weights, curves)
    return points


def read(file: str | Path) -> Drawing:
    """Reads a drawing from an .svg or .csv file. Raises FiveBarError, with one sentence, if the file has no drawing."""
    path = Path(file)
    kinds = {".svg": _svg, ".csv": _csv}
    if path.suffix.lower() not in kinds:
        raise FiveBarError(f"{path}: a drawing is an .svg or a .csv, not {path.suffix or 'a file without ending'}")
    try:
        drawing = kinds[path.suffix.lower()](encoding.content(path, LARGEST))
    except FiveBarError as error:
        raise FiveBarError(f"{path}: {error}") from None
    if not drawing.strokes:
        also = " ".join(("", *drawing.left_out))
        raise FiveBarError(f"{path} has no line to draw.{also}")
    return drawing


# SVG


def _svg(content: bytes) -> Drawing:
    found, remarks = svg.read(content, MOST_STROKES, MOST_CURVES)
    # The y axis of an SVG points down.
    return Drawing([stroke for each in found for stroke in _without_points(each * (MM, -MM))], remarks)


def _without_points(stroke: Floats) -> list[Floats]:
    """The stroke without curves that are points within round-off; an empty list if all are points."""
    if not len(stroke):
        return []
    sizes = np.abs(stroke - stroke[:, :1]).max(axis=(1, 2))
    stroke = stroke[sizes > ROUND_OFF * np.abs(stroke).max()]
    return [stroke] if len(stroke) else []


# CSV


def _csv(content: bytes) -> Drawing:
    rows = list(itertools.islice(table.rows(encoding.decoded(content)), MOST_CURVES + 3))
    scale = MM
    if rows and not _is_number(rows[0][0]):
        scale, rows = _unit_of(rows[0]), rows[1:]
    if len(rows) > MOST_CURVES + 1:
        raise FiveBarError(f"it has more than {MOST_CURVES} lines")
    given = []
    for count, row in enumerate(rows, 1):
        if (
            len(row) not in (2, 3)
            or not all(map(_is_number, row))
            or (len(row) == 3 and table.number(row[2]) not in (0, 1))
        ):
            raise FiveBarError(
                f"row {count} is {','.join(row)!r}: it must be x,y or x,y,pen, with pen 1 on the way there or 0"
            )
        given.append((table.number(row[0]), table.number(row[1]), table.number(row[2]) if len(row) == 3 else 1.0))
    strokes, begin = [], 0
    points = np.array(given).reshape(-1, 3)
    lifted = [*np.flatnonzero(points[1:, 2] == 0) + 1, len(points)]
    if len(lifted) > MOST_STROKES:
        raise FiveBarError(f"it has more than {MOST_STROKES} strokes")
    for end in lifted:
        chain = points[begin:end, :2] * scale
        strokes += _without_points(chain[:-1, None] + np.linspace(0, 1, 4)[:, None] * np.diff(chain, axis=0)[:, None])
        begin = end
    return Drawing(strokes)


def _unit_of(header: list[str]) -> float:
    """The unit in a header's columns, m."""
    found = table.heads(header)
    names = [name.removeprefix("tip.") for name, _ in found]
    units = {unit or "mm" for _, unit in found[:2]}
    if names not in (["x", "y"], ["x", "y", "pen"]) or len(units) != 1 or not units <= set(UNITS):
        raise FiveBarError(
            f"its header is {','.join(header)!r}: it must be as 'x [mm],y [mm],pen', with one of the units {', '.join(UNITS)}"
        )
    return UNITS[units.pop()]


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(table.number(text)))
    except ValueError:
        return False
