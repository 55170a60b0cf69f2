"""Pieces of a drawing that a pen follows without stopping: smooth chains of curves by arc length, and their timing."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fivebar.errors import FiveBarError

Floats = NDArray[np.float64]

CORNER = np.radians(5)
"""Largest change of direction, rad, that a pen passes without stopping."""

PARTS = 8
"""Number of parts of a curve with tabulated arc lengths."""

ENDS = np.linspace(0, 1, PARTS + 1)

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)

Profile = Literal["constant", "minimumJerk"]
"""`constant`: constant acceleration up to the speed, and down from it; `minimumJerk`: 10u³ − 15u⁴ + 6u⁵ (Flash and Hogan 1985, eq. 3)."""


@dataclass(frozen=True)
class Timing:
    """Speed profile of a pen."""

    profile: Profile
    speed: float
    """Speed of the pen, m/s: the constant speed, or the peak speed of a minimum-jerk motion."""

    acceleration: float
    """Largest acceleration along the curve, m/s2."""

    def __post_init__(self) -> None:
        for name, value, unit in (("speed", self.speed, "m/s"), ("acceleration", self.acceleration, "m/s2")):
            if not (np.isfinite(value) and value > 0):
                raise FiveBarError(f"{name} = {value!r} {unit}: it must be positive and finite")

    def duration(self, length: float) -> float:
        """Time to follow a piece of this length, m, in s."""
        if self.profile == "minimumJerk":
            return max(1.875 * length / self.speed, float(np.sqrt(10 / np.sqrt(3) * length / self.acceleration)))
        if length >= self.speed**2 / self.acceleration:
            return length / self.speed + self.speed / self.acceleration
        return 2 * float(np.sqrt(length / self.acceleration))

    def way(self, length: float, share: Floats) -> tuple[Floats, Floats, Floats]:
        """Distance along the piece, m, at times `share` (n,) in [0, 1] of the duration, and its first and second derivative by `share`."""
        if self.profile == "minimumJerk":
            u = share
            return (
                length * u**3 * (10 - 15 * u + 6 * u**2),
                length * 30 * u**2 * (1 - u) ** 2,
                length * 60 * u * (1 - u) * (1 - 2 * u),
            )
        duration = self.duration(length)
        ramp = min(self.speed / self.acceleration / duration, 0.5)
        # Height of the trapezoidal speed profile with the area `length`.
        top = length / (1 - ramp)
        from_start, to_end = np.minimum(share, ramp), np.minimum(1 - share, ramp)
        way = np.where(share < 0.5, top * (from_start**2 / (2 * ramp) + share - from_start), 0.0)
        way = np.where(share < 0.5, way, length - top * (to_end**2 / (2 * ramp) + 1 - share - to_end))
        rate = top * np.minimum(from_start, to_end) / ramp
        return way, rate, top / ramp * (np.where(share < ramp, 1.0, 0.0) - np.where(share > 1 - ramp, 1.0, 0.0))


class Piece:
    """A smooth chain of cubic curves (n, 4, 2), m, between two rests of the tip."""

    def __init__(self, curves: Floats, stroke: int, pen: bool):
        self.curves, self.stroke, self.pen = curves, stroke, pen
        """`stroke` counts from 1; a move with lifted pen has the number of the next stroke. `pen` is whether the pen is down."""

    @cached_property
    def _before(self) -> Floats:
        """Arc lengths at the beginnings of all parts, and the total length, m, (PARTS n + 1,); computed only if the piece is drawn."""
        lengths = _lengths(self.curves[:, None], ENDS[:-1], ENDS[1:])
        return np.concatenate([[0.0], np.cumsum(lengths.ravel())])

    @property
    def length(self) -> float:
        """Arc length, m."""
        return float(self._before[-1])

    @property
    def chord(self) -> float:
        """Distance between the ends, m: at most the arc length."""
        return math.dist(self.curves[0, 0], self.curves[-1, 3])

    def at(self, way: Floats) -> tuple[Floats, Floats, Floats]:
        """Positions, m, unit tangents and curvature vectors, 1/m, (n, 2) each, at arc lengths `way` (n,), m."""
        part = np.clip(np.searchsorted(self._before, way, side="right") - 1, 0, len(self._before) - 2)
        curve, within = np.divmod(part, PARTS)
        curves, begin, end = self.curves[curve], ENDS[within], ENDS[within + 1]
        left, whole = way - self._before[part], self._before[part + 1] - self._before[part]
        u = begin + (end - begin) * np.divide(left, whole, out=np.zeros_like(left), where=whole > 0)
        for _ in range(4):  # Newton: each iteration doubles the digits
            speed = np.maximum(np.hypot(*_derivative(curves, u).T), np.finfo(float).tiny)
            u = np.clip(u - (_lengths(curves, begin, u) - left) / speed, begin, end)
        place, first, second = _place(curves, u), _derivative(curves, u), _second(curves, u)
        speed = np.hypot(*first.T)[:, None]
        # If a curve begins or ends with two equal points, its derivative is zero there: use the direction to the next point.
        direction = np.where(speed > 1e-9 * self.length, first, _direction_at_ends(curves, u))
        tangent = direction / np.hypot(*direction.T)[:, None]
        across = second - np.sum(second * tangent, axis=-1, keepdims=True) * tangent
        return place, tangent, np.divide(across, speed**2, out=np.zeros_like(across), where=speed > 1e-9 * self.length)


def of(strokes: list[Floats]) -> list[Piece]:
    """The pieces of all strokes in order, joined by straight moves with lifted pen."""
    pieces: list[Piece] = []
    for number, stroke in enumerate(strokes, 1):
        if pieces and np.any((end := pieces[-1].curves[-1, 3]) != stroke[0, 0]):
            pieces.append(Piece((end + np.linspace(0, 1, 4)[:, None] * (stroke[0, 0] - end))[None], number, False))
        arriving, leaving = _first_difference(stroke[:, ::-1]), _first_difference(stroke)
        turn = np.abs(np.arctan2(_cross(-arriving[:-1], leaving[1:]), np.sum(-arriving[:-1] * leaving[1:], axis=-1)))
        pieces += [Piece(chain, number, True) for chain in np.split(stroke, np.flatnonzero(turn > CORNER) + 1)]
    return pieces


def _cross(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _first_difference(curves: Floats) -> Floats:
    """Vectors from the first point of curves (n, 4, 2) to the next different point, (n, 2)."""
    found = np.zeros((len(curves), 2))
    for i in (3, 2, 1):
        difference = curves[:, i] - curves[:, 0]
        found = np.where(np.any(difference != 0, axis=-1, keepdims=True), difference, found)
    return found


def _direction_at_ends(curves: Floats, u: Floats) -> Floats:
    """Directions of curves (n, 4, 2) at their beginning or, if u is beyond the middle, at their end, (n, 2)."""
    return np.where(u[:, None] < 0.5, _first_difference(curves), -_first_difference(curves[:, ::-1]))


def _weighted(curves: Floats, weights: list[Floats]) -> Floats:
    return sum((w[..., None] * curves[..., i, :] for i, w in enumerate(weights)), np.zeros(2))


def _place(curves: Floats, u: Floats) -> Floats:
    v = 1 - u
    return _weighted(curves, [v**3, 3 * u * v**2, 3 * u**2 * v, u**3])


def _derivative(curves: Floats, u: Floats) -> Floats:
    v = 1 - u
    return 3 * _weighted(np.diff(curves, axis=-2), [v**2, 2 * u * v, u**2])


def _second(curves: Floats, u: Floats) -> Floats:
    return 6 * _weighted(np.diff(curves, 2, axis=-2), [1 - u, u])


def _lengths(curves: Floats, begin: Floats, end: Floats) -> Floats:
    """Arc lengths of curves (..., 4, 2) between parameters (...), by Gauss-Legendre quadrature."""
    middle, half = (begin + end) / 2, (end - begin) / 2
    lengths: Floats = np.zeros(np.broadcast_shapes(curves.shape[:-2], middle.shape))
    for node, weight in zip(NODES.tolist(), WEIGHTS.tolist()):
        lengths = lengths + weight * half * np.linalg.norm(_derivative(curves, middle + node * half), axis=-1)
    return lengths
