"""Borders of the regions in which the tip can move: circles of inverse singularities, direct loci by working mode, arcs of
stops; how far a place is from them; their points for pages.
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
"""Points of a whole direct locus; its pieces between them are taken as straight."""

BLOCK = 100_000
"""Distances that are computed at a time."""


class Curve(NamedTuple):
    """A piece of a curve along which the working mode stays the same."""

    kind: str
    """`direct`: distal links in line; `stop`: a motor at one of its stops."""

    detail: str
    """`stretched` or `folded`; the limit's name."""

    tip: Floats
    """m, shape (n, 2)."""

    theta: Floats
    """Angles of the links 1 to 4, rad, shape (n, 4)."""


def stop_margin(scene: Scene, motors: Floats) -> Floats:
    """How far motor angles (..., 2), rad, are from the nearest of the scene's stops, rad, negative beyond it; in the best of their turns."""
    margin = np.full(motors.shape[:-1], np.inf)
    if scene["stop.enabled"]:
        for leg in (0, 1):
            lower, upper = (float(scene[f"stop.{limit}[{leg + 1}]"]) for limit in ("lower", "upper"))
            off = np.abs(np.remainder(motors[..., leg] - (lower + upper) / 2 + np.pi, 2 * np.pi) - np.pi)
            if upper - lower < 2 * np.pi:
                margin = np.minimum(margin, (upper - lower) / 2 - off)
    return margin


def bends_like(theta: Floats, working: Working) -> Flags:
    """Whether postures (..., 4) are in a working mode, its rim included."""
    alike: Flags = np.all(sines(theta)[..., 1:] * np.array([SIGN[bend] for bend in working]) >= -1e-12, axis=-1)
    return alike


def stretches(flags: Flags, beyond: int = 0) -> list[slice]:
    """Ranges of at least two points along which the flags are set, or so many points beyond those."""
    for _ in range(beyond):
        flags = flags | np.append(flags[1:], False) | np.append(False, flags[:-1])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [slice(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2]) if end - begin > 1]


def borders(scene: Scene, machine: Machine, working: Working) -> list[Curve]:
    """Direct loci and arcs of stops of a working mode, each a point longer than in that mode: where they meet, they leave no gap."""
    return direct_curves(machine, working, 1) + stop_curves(scene, machine, working, 1)


def direct_curves(machine: Machine, working: Working, beyond: int = 0) -> list[Curve]:
    """Pieces of the direct loci that belong to a working mode, or are so many points beyond: in the others the same place may be regular."""
    return [
        Curve("direct", locus.posture, locus.tip[part], locus.theta[part])
        for locus in machine.direct_singularities(CURVE_POINTS)
        for part in stretches(bends_like(locus.theta, working), beyond)
    ]


def stop_curves(scene: Scene, machine: Machine, working: Working, beyond: int = 0) -> list[Curve]:
    """Arcs of the tip with a motor at one of its stops and the other within its own, or so many points beyond."""
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
            # The leg at its stop is there but for round-off.
            other[:, leg] = (lower + upper) / 2
            on = reached & bend & (stop_margin(scene, other) >= 0)
            curves += [
                Curve("stop", f"stop.{limit}[{leg + 1}]", tip[part], posture.theta[part])
                for part in stretches(on, beyond)
            ]
    return curves


# Distances


class Obstacles:
    """Borders that discs and paths must not touch: the circles of inverse singularities, and pieces of curves as chains of straight ones."""

    def __init__(self, circles: list[Circle], chains: list[Floats]):
        self.circles = circles
        self.begin = np.concatenate([chain[:-1] for chain in chains]) if chains else np.zeros((0, 2))
        self.along = np.concatenate([np.diff(chain, axis=0) for chain in chains]) if chains else np.zeros((0, 2))
        self.squared = np.maximum(np.sum(self.along**2, axis=-1), np.finfo(float).tiny)

    def near(self, middle: Floats, radius: float) -> "Obstacles":
        """Those that may matter within a radius of a place."""
        near = Obstacles(self.circles, [])
        kept = np.hypot(*(self.begin - middle).T) <= radius + np.sqrt(self.squared)
        near.begin, near.along, near.squared = self.begin[kept], self.along[kept], self.squared[kept]
        return near

    def distance(self, places: Floats) -> Floats:
        """Distances of places (n, 2) from the nearest obstacle."""
        nearest = self._from_chains(places)
        for circle in self.circles:
            nearest = np.minimum(nearest, np.abs(np.hypot(*(places - np.array(circle.centre)).T) - circle.radius))
        return nearest

    def _from_chains(self, places: Floats) -> Floats:
        """Distances from the chains: places that are far from each other are divided, each half looks at what is near it."""
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
"""The script by which pages draw an outline."""

SHOWN_POINTS = 400
"""Points of a whole direct locus on a page."""


def outline(machine: Machine) -> dict[str, Any]:
    """Reach and direct loci for pages, in m: `rings` about the motors, and for each working mode the curves that belong to it."""
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
    """Every so many points of a curve (n, 2), and its last one, to 1e-5 of the machine's size."""
    digits = 5 - int(np.floor(np.log10(machine.size)))
    rows = np.unique(np.append(np.arange(0, len(tip), stride), len(tip) - 1))
    return [[round(float(x), digits), round(float(y), digits)] for x, y in tip[rows]]
