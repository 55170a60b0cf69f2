"""Workspace of a machine in each working mode: reach, singular loci, condition number, stops, largest discs and tip force.

`compute` makes the map of a scene, `write` its tables, `fivebar.workspace_pictures.draw` its pictures and
`fivebar.map_page.write` a page.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fivebar import statics, table
from fivebar.borders import Curve, Obstacles, bends_like, direct_curves, stop_curves, stop_margin, stretches
from fivebar.errors import FiveBarError
from fivebar.kinematics import WORKING_MODES, Circle, Machine, Sign, Working, mode_name, sines
from fivebar.scene import Scene

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

TIP, ANGLES = ("tip.x", "tip.y"), ("theta[1]", "passive.theta[1]", "passive.theta[2]", "theta[2]")
"""The unit's names for the position of the tip and the angles of the links 1 to 4."""

CELLS = 160
"""Number of cells along the longer side of the reach."""

DISC_TOLERANCE = 1e-8
"""Tolerance of disc radii, in multiples of the machine's size."""

MOST_DISCS = 3
"""Largest number of discs in an aspect."""

MOST_CELLS = 48
"""Largest number of cells in the search for a disc. If many points are equally good, as on a ring, some of them are enough."""


class Disc(NamedTuple):
    """A largest disc within the stops and one aspect, a connected region of the tip without singularity."""

    assembly: Sign
    x: float
    y: float
    radius: float


class Path(NamedTuple):
    """Motion of a scene."""

    time: Floats
    """Time, s, shape (n,)."""

    tip: Floats
    """Position of the tip, m, shape (n, 2)."""

    theta: Floats
    """Angles of the links 1 to 4, rad, shape (n, 4)."""

    def parts(self, working: Working) -> list[slice]:
        """Parts of the motion in a working mode."""
        return stretches(bends_like(self.theta, working))


@dataclass(frozen=True)
class Mode:
    """The map of a working mode: fields over (y, x) without NaN; values are meaningful only at `reached` points."""

    working: Working
    theta: Floats
    """Angles of the links 1 to 4, rad, shape (ny, nx, 4)."""

    reached: Flags
    stop_margin: Floats
    """Margin of the motors to their stops, rad: negative beyond a stop, infinite without stops."""

    dexterity: Floats
    """Reciprocal of the condition number, in [0, 1]."""

    force: Floats | None
    """Force that the tip at rest can hold in every direction, N; None without torque limits."""

    curves: list[Curve]
    discs: list[Disc]

    @property
    def within_stops(self) -> Flags:
        """Whether both motors are within their stops."""
        return self.stop_margin >= 0

    @property
    def name(self) -> str:
        """Name of the working mode, such as `minusPlus`, as in the unit's `mode.working`."""
        return mode_name(self.working)


@dataclass(frozen=True)
class Map:
    """The map of a scene."""

    scene: Scene
    machine: Machine
    limits: tuple[float, float] | None
    """Torque limits of the motors, N·m."""

    x: Floats
    y: Floats
    """Axes of the fields, m."""

    circles: list[Circle]
    """Inverse singularities, the same for all working modes."""

    modes: list[Mode]
    path: Path | None


def compute(
    scene: Scene,
    limits: tuple[float, float] | None = None,
    path: Path | None = None,
    cells: int = CELLS,
    modes: Iterable[Working] = WORKING_MODES,
) -> Map:
    """The map of a scene. The default torque limits, N·m, are the limits of its servos; `path` is a motion to show."""
    machine = Machine.from_scene(scene)
    if limits is None and scene["servo.enabled"]:
        limits = float(scene["servo.limit[1]"]), float(scene["servo.limit[2]"])
    x, y = _axes(machine, cells)
    made = [_mode(scene, machine, working, limits, x, y) for working in modes]
    return Map(scene, machine, limits, x, y, machine.inverse_singularities(), made, path)


def follow(scene: Scene) -> Path:
    """The scene's motion, simulated by the unit."""
    from fivebar import simulate

    result = simulate.run(scene)
    tip, theta = (np.stack([result[name] for name in names], axis=-1) for names in (TIP, ANGLES))
    return Path(result.time, tip, theta)


def _axes(machine: Machine, cells: int) -> tuple[Floats, Floats]:
    """Axes of a grid of square cells over the reach, symmetric about the x axis."""
    (near_left, left), (near_right, right) = machine.reach.tolist()
    if machine.reach_area <= 0:
        raise FiveBarError(
            f"base.distance = {machine.distance:.10g} m: the left leg reaches from {near_left:.10g} to {left:.10g} m, the right one from "
            f"{near_right:.10g} to {right:.10g} m, so that they never meet; both must reach some common place."
        )
    begin, end = max(-left, machine.distance - right), min(left, machine.distance + right)
    # The lens of both outer circles is highest at their intersection, or at the top of a circle inside the lens.
    crossing = (machine.distance**2 + left**2 - right**2) / (2 * machine.distance) if machine.distance > 0 else 0.0
    centre_inside = begin <= 0 <= end and left <= right or begin <= machine.distance <= end and right <= left
    height = min(left, right) if centre_inside else float(np.sqrt(max(left**2 - crossing**2, 0.0)))
    size = max(end - begin, 2 * height) / cells
    columns, rows = int(np.ceil((end - begin) / size)), int(np.ceil(height / size))
    middle = (begin + end) / 2
    return middle + size * (np.arange(columns + 1) - columns / 2), size * np.arange(-rows, rows + 1.0)


def _mode(
    scene: Scene, machine: Machine, working: Working, limits: tuple[float, float] | None, x: Floats, y: Floats
) -> Mode:
    places = np.stack(np.meshgrid(x, y), axis=-1)
    posture, reached = machine.field(places, working)
    curves = direct_curves(machine, working) + stop_curves(scene, machine, working)
    return Mode(
        working=working,
        theta=posture.theta,
        reached=reached,
        stop_margin=stop_margin(scene, posture.motors),
        dexterity=machine.dexterity(posture.theta),
        force=None if limits is None else statics.tip_force(scene, posture.theta, limits),
        curves=curves,
        discs=[] if machine.is_degenerate(working) else _discs(scene, machine, working, curves, x, y),
    )


# Largest discs


def _coarse(chain: Floats) -> tuple[Floats, float]:
    """A chain of every 16th point, and a bound of its distance from the full chain."""
    rows = np.append(np.arange(0, len(chain) - 1, 16), len(chain) - 1)
    lengths = np.hypot(*np.diff(chain, axis=0).T)
    return chain[rows], float(np.add.reduceat(lengths, rows[:-1]).max() / 2)


def _aspects(regions: NDArray[np.int8]) -> list[tuple[int, Flags]]:
    """Sets of cells with the same nonzero kind, connected by their sides, each with its kind."""
    labels = np.where(regions != 0, np.arange(1, regions.size + 1).reshape(regions.shape), 0)
    while True:
        before = labels.copy()
        for axis in (0, 1):
            low, high = (
                (slice(None, -1), slice(1, None))
                if axis == 0
                else ((slice(None), slice(None, -1)), (slice(None), slice(1, None)))
            )
            joined = (regions[low] == regions[high]) & (regions[low] != 0)
            smaller = np.minimum(labels[low], labels[high])
            labels[low] = np.where(joined, smaller, labels[low])
            labels[high] = np.where(joined, np.minimum(smaller, labels[high]), labels[high])
        # A label is the number of a cell; take over that cell's label, which may have become smaller.
        labels = np.where(labels > 0, labels.ravel()[labels - 1], 0)
        if np.array_equal(labels, before):
            break
    return [(int(regions.ravel()[label - 1]), labels == label) for label in np.unique(labels[labels > 0]).tolist()]


def _discs(scene: Scene, machine: Machine, working: Working, curves: list[Curve], x: Floats, y: Floats) -> list[Disc]:
    """The largest discs of each aspect, sorted by size.

    An aspect is a connected region without singularity. Discs in the same aspect do not touch each other, and discs of a few
    cells are left out.
    """
    circles, chains = machine.inverse_singularities(), [curve.tip for curve in curves]
    coarse = [_coarse(chain) for chain in chains]
    fine, rough = Obstacles(circles, chains), Obstacles(circles, [chain for chain, _ in coarse])
    slack = max((slack for _, slack in coarse), default=0.0)

    def region(places: Floats) -> NDArray[np.int8]:
        posture, reached = machine.field(places, working)
        allowed = reached & (stop_margin(scene, posture.motors) >= 0)
        return np.where(allowed, np.sign(sines(posture.theta)[..., 0]), 0).astype(np.int8)

    cell = float(x[1] - x[0])
    places = np.stack(np.meshgrid(x, y), axis=-1)
    discs: list[Disc] = []
    for side, aspect in _aspects(region(places)):
        start = places[::2, ::2][aspect[::2, ::2]]
        found: list[Disc] = []
        while len(start) and len(found) < MOST_DISCS:

            def room(middles: Floats, near: Obstacles, side: int = side, taken: list[Disc] = found) -> Floats:
                """Distance from all obstacles and previous discs, negative outside the region."""
                distance = near.distance(middles)
                distance = np.where(region(middles) == side, distance, -distance)
                for disc in taken:
                    distance = np.minimum(distance, np.hypot(*(middles - np.array(disc[1:3])).T) - disc.radius)
                return distance

            middle, radius = _roomiest(room, start, 2 * cell, rough, fine, slack, DISC_TOLERANCE * machine.size)
            apart = [np.hypot(*(middle - np.array(disc[1:3]))) - disc.radius - radius for disc in found]
            if radius < 2 * cell or min(apart, default=1.0) < 10 * DISC_TOLERANCE * machine.size:
                break
            found.append(Disc("plus" if side > 0 else "minus", float(middle[0]), float(middle[1]), radius))
        discs += found
    return sorted(discs, key=lambda disc: -disc.radius)


def _roomiest(
    room: Callable[[Floats, Obstacles], Floats],
    middles: Floats,
    size: float,
    rough: Obstacles,
    fine: Obstacles,
    slack: float,
    tolerance: float,
) -> tuple[Floats, float]:
    """The point with the largest room in square cells around `middles`, and its room (branch and bound).

    Room is a distance, so it changes by at most the distance between two points. The room in a cell therefore exceeds the room
    at its middle by at most half its diagonal. Cells that cannot exceed the best room so far are dropped, the others divided
    until they are small enough. `rough` obstacles have errors up to `slack`; `fine` ones replace them once cells are small.
    """
    near, error = rough, slack
    values = room(middles, near)
    while size > tolerance or error > 0:
        best = float(values.max())
        kept = np.flatnonzero(values + size / np.sqrt(2) + 2 * error > max(best, 0.0))
        kept = kept[np.argsort(-values[kept])][:MOST_CELLS]
        if not len(kept):
            break
        best_place = middles[np.argmax(values)]
        size /= 2
        shifts = size / 2 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
        middles = np.concatenate([(middles[kept, None] + shifts).reshape(-1, 2), best_place[None]])
        centre = (middles.min(axis=0) + middles.max(axis=0)) / 2
        spread = float(np.hypot(*(middles - centre).T).max())
        if error > 0 and size < 2 * slack:
            near, error = fine, 0.0
        near = near.near(centre, max(best, 0.0) + 2 * (spread + size + slack))
        values = room(middles, near)
    return middles[np.argmax(values)], float(values.max())


# Tables


def write(survey: Map, folder: str | FilePath) -> list[FilePath]:
    """Writes `field.csv`, `loci.csv`, `discs.csv` and, if there is a motion, `path.csv` to a folder; returns the files.

    Units are s, m, rad and N.
    """
    directory = FilePath(folder)
    directory.mkdir(parents=True, exist_ok=True)
    tables: dict[str, tuple[list[str], Iterable[Sequence[object]]]] = {
        "field.csv": (
            ["working", "x", "y", "assembly", *ANGLES, "dexterity", "within_stops", "force"],
            _field_rows(survey),
        ),
        "loci.csv": (["working", "kind", "detail", "piece", "x", "y", *ANGLES], _locus_rows(survey)),
        "discs.csv": (
            ["working", "assembly", "x", "y", "radius"],
            ([mode.name, disc.assembly, *disc[1:]] for mode in survey.modes for disc in mode.discs),
        ),
    }
    if survey.path is not None:
        rows = np.column_stack([survey.path.time, survey.path.tip, survey.path.theta]).tolist()
        tables["path.csv"] = (["time", "x", "y", *ANGLES], rows)
    for name, (header, rows) in tables.items():
        short = ([f"{value:.9g}" if isinstance(value, float) else value for value in row] for row in rows)
        table.write(directory / name, header, short)
    return [directory / name for name in tables]


def _field_rows(survey: Map) -> Iterable[list[object]]:
    """One row for each reached point."""
    places = np.stack(np.meshgrid(survey.x, survey.y), axis=-1)
    for mode in survey.modes:
        on = mode.reached
        assembly = np.where(sines(mode.theta[on])[:, 0] >= 0, "plus", "minus").tolist()
        force = [""] * len(assembly) if mode.force is None else mode.force[on].tolist()
        columns = (
            places[on].tolist(),
            assembly,
            mode.theta[on].tolist(),
            mode.dexterity[on].tolist(),
            mode.within_stops[on].tolist(),
            force,
        )
        for place, side, theta, dexterity, within, held in zip(*columns):
            yield [mode.name, *place, side, *theta, dexterity, int(within), held]


def _locus_rows(survey: Map) -> Iterable[list[object]]:
    """Every tenth point of the curves of each mode, and circles, with angles that depend on the mode."""
    for number, circle in enumerate(survey.circles):
        for angle in np.linspace(-np.pi, np.pi, 361).tolist():
            tip = circle.centre[0] + circle.radius * np.cos(angle), circle.centre[1] + circle.radius * np.sin(angle)
            yield [
                "",
                "inverse",
                f"{('left', 'right')[circle.leg]} {circle.posture}",
                number,
                *map(float, tip),
                "",
                "",
                "",
                "",
            ]
    for mode in survey.modes:
        for number, curve in enumerate(mode.curves):
            rows = np.column_stack([curve.tip, curve.theta])
            for row in [*rows[:-1:10].tolist(), rows[-1].tolist()]:
                yield [mode.name, curve.kind, curve.detail, number, *row]


def summary(survey: Map) -> list[str]:
    """Sentences on a map."""
    machine = survey.machine
    lines = [f"{survey.scene.name}: both legs reach {machine.reach_area:.6g} m2."]
    for mode in survey.modes:
        if machine.is_degenerate(mode.working):
            lines.append(f"{mode.name}: every posture is a direct singularity.")
        for disc in mode.discs:
            lines.append(
                f"{mode.name}, assembly {disc.assembly}: largest disc without singularity at ({disc.x:.5f}, {disc.y:.5f}) m, "
                f"radius {disc.radius:.5f} m."
            )
    return lines
