"""Borders of the regions in which the tip can move: circles of inverse singularities, loci of direct singularities in each
working mode, and arcs at end stops. Also the distance of a point from the borders, and their points for pages.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fivebar.kinematics import SIGN, WORKING_MODES, Circle, Machine, Working, sines
from fivebar.scene import Scene

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

CURVE_POINTS = 8000
"""Points of a whole direct locus; it counts as straight between them."""

BLOCK = 100_000
"""Number of distances computed at once: bounds the memory."""


class Curve(NamedTuple):
    """A piece of a curve along which the working mode stays the same."""

    kind: str
    """`direct`: distal links in line; `stop`: a motor at one of its stops."""

    detail: str
    """`stretched` or `folded` for a direct locus; the name of the limit for a stop."""

    tip: Floats
    """Positions of the tip, m, shape (n, 2)."""

    theta: Floats
    """Angles of the links 1 to 4, rad, shape (n, 4)."""


def stop_margin(scene: Scene, motors: Floats) -> Floats:
    """Margin of motor angles (..., 2), rad, to the nearest end stop of the scene, rad: negative beyond it.

    Each angle counts at the whole turn with the largest margin.
    """
    margin = np.full(motors.shape[:-1], np.inf)
    if scene["stop.enabled"]:
        for leg in (0, 1):
            lower, upper = (float(scene[f"stop.{limit}[{leg + 1}]"]) for limit in ("lower", "upper"))
            off = np.abs(np.remainder(motors[..., leg] - (lower + upper) / 2 + np.pi, 2 * np.pi) - np.pi)
            if upper - lower < 2 * np.pi:
                margin = np.minimum(margin, (upper - lower) / 2 - off)
    return margin


def bends_like(theta: Floats, working: Working) -> Flags:
    """Whether postures (..., 4) are in a working mode or on its boundary."""
    alike: Flags = np.all(sines(theta)[..., 1:] * np.array([SIGN[bend] for bend in working]) >= -1e-12, axis=-1)
    return alike


def stretches(flags: Flags, beyond: int = 0) -> list[slice]:
    """Ranges of at least two consecutive points with set flags, extended by `beyond` points at both ends."""
    for _ in range(beyond):
        flags = flags | np.append(flags[1:], False) | np.append(False, flags[:-1])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [slice(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2]) if end - begin > 1]


def borders(scene: Scene, machine: Machine, working: Working) -> list[Curve]:
    """Direct loci and stop arcs of a working mode, each extended by one point at both ends so that no gap remains between them."""
    return direct_curves(machine, working, 1) + stop_curves(scene, machine, working, 1)


def direct_curves(machine: Machine, working: Working, beyond: int = 0) -> list[Curve]:
    """Pieces of the direct loci in a working mode, extended by `beyond` points. The same point may be regular in another mode."""
    return [
        Curve("direct", locus.posture, locus.tip[part], locus.theta[part])
        for locus in machine.direct_singularities(CURVE_POINTS)
        for part in stretches(bends_like(locus.theta, working), beyond)
    ]


def stop_curves(scene: Scene, machine: Machine, working: Working, beyond: int = 0) -> list[Curve]:
    """Arcs of the tip while one motor is at a stop and the other within its stops, extended by `beyond` points."""
    if not scene["stop.enabled"]:
        return []
    curves = []
    phi = np.linspace(-np.pi, np.pi, CURVE_POINTS // 2)
    for leg in (0, 1):
        lower, upper = (float(scene[f"stop.{limit}[{leg + 1}]"]) for limit in ("lower", "upper"))
        if upper - lower >= 2 * np.pi:
            continue
        proximal, distal = machine.legs[leg]
        for limit, angle in (("lower", lower), ("upper", upper)):
            elbow = machine.motors[leg] + proximal * np.array([np.cos(angle), np.sin(angle)])
            tip = elbow + distal * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
            posture, reached = machine.field(tip, working)
            bend = np.sin(phi - angle) * SIGN[working[leg]] >= 0
            other = posture.motors.copy()
            # This leg is at its stop except for round-off; its middle angle passes the test.
            other[:, leg] = (lower + upper) / 2
            on = reached & bend & (stop_margin(scene, other) >= 0)
            curves += [
                Curve("stop", f"stop.{limit}[{leg + 1}]", tip[part], posture.theta[part])
                for part in stretches(on, beyond)
            ]
    return curves


# Distances


class Obstacles:
    """Borders that discs and paths must not touch: circles of inverse singularities, and curves as chains of straight segments."""

    def __init__(self, circles: list[Circle], chains: list[Floats]):
        self.circles = circles
        self.begin = np.concatenate([chain[:-1] for chain in chains]) if chains else np.zeros((0, 2))
        self.along = np.concatenate([np.diff(chain, axis=0) for chain in chains]) if chains else np.zeros((0, 2))
        self.squared = np.maximum(np.sum(self.along**2, axis=-1), np.finfo(float).tiny)

    def near(self, middle: Floats, radius: float) -> "Obstacles":
        """The obstacles that may lie within a radius of a point."""
        near = Obstacles(self.circles, [])
        kept = np.hypot(*(self.begin - middle).T) <= radius + np.sqrt(self.squared)
        near.begin, near.along, near.squared = self.begin[kept], self.along[kept], self.squared[kept]
        return near

    def distance(self, places: Floats) -> Floats:
        """Distances of points (n, 2) from the nearest obstacle."""
        nearest = self._from_chains(places)
        for circle in self.circles:
            nearest = np.minimum(nearest, np.abs(np.hypot(*(places - np.array(circle.centre)).T) - circle.radius))
        return nearest

    def _from_chains(self, places: Floats) -> Floats:
        """Distances from the chains. Large sets of points are split in two, and each half considers only segments near it."""
        if len(places) > 1 and len(places) * len(self.begin) > BLOCK:
            order = np.argsort(places[:, np.argmax(np.ptp(places, axis=0))])
            distances = np.empty(len(places))
            for half in np.array_split(order, 2):
                centre = (places[half].min(axis=0) + places[half].max(axis=0)) / 2
                spread = float(np.hypot(*(places[half] - centre).T).max())
                farthest = float(self._from_chains(centre[None])[0]) + 2 * spread
                distances[half] = self.near(centre, farthest)._from_chains(places[half])
            return distances
        if not len(self.begin):
            return np.full(len(places), np.inf)
        x, y = (places[:, axis, None] - self.begin[:, axis] for axis in (0, 1))
        share = np.clip((x * self.along[:, 0] + y * self.along[:, 1]) / self.squared, 0, 1)
        apart: Floats = np.sqrt(
            np.min((x - share * self.along[:, 0]) ** 2 + (y - share * self.along[:, 1]) ** 2, axis=-1)
        )
        return apart


# For pages

REACH = Path(__file__).with_name("reach.js")
"""The script with which pages draw an outline."""

SHOWN_POINTS = 400
"""Points of a whole direct locus on a page."""


def outline(machine: Machine) -> dict[str, Any]:
    """Reach and direct loci for pages, m: `rings` about the motors, and `loci` as the curves of each working mode."""
    return {
        "rings": [
            {"centre": [float(x), float(y)], "inner": float(inner), "outer": float(outer)}
            for (x, y), (inner, outer) in zip(machine.motors, machine.reach)
        ],
        "loci": {
            left + right.capitalize(): [shown(curve.tip, machine) for curve in direct_curves(machine, (left, right))]
            for left, right in WORKING_MODES
        },
    }


def shown(tip: Floats, machine: Machine, stride: int = CURVE_POINTS // SHOWN_POINTS) -> list[list[float]]:
    """Every `stride`-th point of a curve (n, 2) and its last point, rounded to 1e-5 of the machine's size."""
    digits = 5 - int(np.floor(np.log10(machine.size)))
    rows = np.unique(np.append(np.arange(0, len(tip), stride), len(tip) - 1))
    return [[round(float(x), digits), round(float(y), digits)] for x, y in tip[rows]]
