"""Workspace of a machine: reach, singular loci, condition number, stops, largest discs and the tip's force, by working mode.

`compute` makes the map of a scene, `write` its tables, `fivebar.workspace_pictures.draw` its pictures. From a shell, in a checkout in which
`cargo xtask package` has run: python -m fivebar.workspace SCENE [--out DIR]
"""

import argparse
import contextlib
import csv
import io
import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fivebar import scene as scenes
from fivebar import shipped
from fivebar import statics
from fivebar.kinematics import SIGN, WORKING_MODES, Circle, Machine, Sign, Working, sines
from fivebar.scene import Scene

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

TIP, ANGLES = ("tip.x", "tip.y"), ("theta[1]", "passive.theta[1]", "passive.theta[2]", "theta[2]")
"""The unit's names of the tip's position and of the angles of the links 1 to 4."""

CELLS = 160
"""Cells of the field along the longer side of the reach."""

CURVE_POINTS = 8000
"""Points of a whole direct locus; its pieces between them are taken as straight."""

DISC_TOLERANCE = 1e-8
"""Tolerance of the discs' radii, in multiples of the machine's size."""

BLOCK = 100_000
"""Distances that are computed at a time."""

MOST_DISCS = 3
"""Discs that are looked for in an aspect."""

MOST_CELLS = 48
"""Cells that the search for a disc keeps at a time: where many places are equally good, as on a ring, some of them are enough."""


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


class Disc(NamedTuple):
    """A largest disc within an aspect, a connected region of the tip without singularity, and within the stops."""

    assembly: Sign
    x: float
    y: float
    radius: float


class Path(NamedTuple):
    """Motion of a scene."""

    time: Floats
    """s, shape (n,)."""

    tip: Floats
    """m, shape (n, 2)."""

    theta: Floats
    """Angles of the links 1 to 4, rad, shape (n, 4)."""

    def parts(self, working: Working) -> list[slice]:
        """Stretches in a working mode."""
        return _stretches(_bends_like(self.theta, working))


@dataclass(frozen=True)
class Mode:
    """The map of a working mode: fields over (y, x) as NaN-free arrays, which mean something where `reached`."""

    working: Working
    theta: Floats
    """Angles of the links 1 to 4, rad, shape (ny, nx, 4)."""

    reached: Flags
    stop_margin: Floats
    """How far the motors are from their stops, rad, negative beyond one; infinite without stops."""

    dexterity: Floats
    """1 over the condition number, in [0, 1]."""

    force: Floats | None
    """Force that the tip at rest holds in every direction, N; None without limits of torque."""

    curves: list[Curve]
    discs: list[Disc]

    @property
    def within_stops(self) -> Flags:
        """Whether both motors are within their stops."""
        return self.stop_margin >= 0

    @property
    def name(self) -> str:
        """Such as `minusPlus`, as the unit's `mode.working` has it."""
        return self.working[0] + self.working[1].capitalize()


@dataclass(frozen=True)
class Map:
    """The map of a scene."""

    scene: Scene
    machine: Machine
    limits: tuple[float, float] | None
    """Limits of the motors' torques, N·m."""

    x: Floats
    y: Floats
    """Axes of the fields, m."""

    circles: list[Circle]
    """Inverse singularities, which all working modes share."""

    modes: list[Mode]
    path: Path | None


def compute(
    scene: Scene, limits: tuple[float, float] | None = None, path: Path | None = None, cells: int = CELLS, modes: Iterable[Working] = WORKING_MODES
) -> Map:
    """The map of a scene. Limits of torque, N·m, are those of its servos unless given; `path` is a motion to show."""
    machine = Machine.from_scene(scene)
    if limits is None and scene["servo.enabled"]:
        limits = float(scene["servo.limit[1]"]), float(scene["servo.limit[2]"])
    x, y = _axes(machine, cells)
    made = [_mode(scene, machine, working, limits, x, y) for working in modes]
    return Map(scene, machine, limits, x, y, machine.inverse_singularities(), made, path)


def follow(scene: Scene) -> Path:
    """The scene's motion, by the unit that `cargo xtask package` has made."""
    from fmpy import extract, simulate_fmu

    inputs = np.zeros(len(scene.time), dtype=[("time", float), *((name, float) for name in scene.signals)])
    inputs["time"] = scene.time
    for name, values in scene.signals.items():
        inputs[name] = values
    folder = extract(str(shipped.unit()))
    try:
        # FMPy prints that inputs without signals keep their values.
        with contextlib.redirect_stdout(io.StringIO()):
            result = simulate_fmu(
                folder,
                stop_time=scene.stop_time,
                output_interval=scene.step_size,
                start_values=dict(scene.values),
                input=inputs if scene.signals else None,
                output=[*TIP, *ANGLES],
            )
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    tip, theta = (np.stack([result[name] for name in names], axis=-1) for names in (TIP, ANGLES))
    return Path(result["time"], tip, theta)


def _axes(machine: Machine, cells: int) -> tuple[Floats, Floats]:
    """Axes of a grid of square cells over the reach, symmetric about the x axis."""
    (near_left, left), (near_right, right) = machine.reach.tolist()
    if machine.reach_area <= 0:
        raise ValueError(
            f"base.distance = {machine.distance:.10g} m: the left leg reaches from {near_left:.10g} to {left:.10g} m, the right one from "
            f"{near_right:.10g} to {right:.10g} m, so that they never meet; both must reach some common place."
        )
    begin, end = max(-left, machine.distance - right), min(left, machine.distance + right)
    # The lens of both outer circles is highest where they meet, or where one of them is whole.
    crossing = (machine.distance**2 + left**2 - right**2) / (2 * machine.distance) if machine.distance > 0 else 0.0
    centre_inside = begin <= 0 <= end and left <= right or begin <= machine.distance <= end and right <= left
    height = min(left, right) if centre_inside else float(np.sqrt(max(left**2 - crossing**2, 0.0)))
    size = max(end - begin, 2 * height) / cells
    columns, rows = int(np.ceil((end - begin) / size)), int(np.ceil(height / size))
    middle = (begin + end) / 2
    return middle + size * (np.arange(columns + 1) - columns / 2), size * np.arange(-rows, rows + 1.0)


def _mode(scene: Scene, machine: Machine, working: Working, limits: tuple[float, float] | None, x: Floats, y: Floats) -> Mode:
    places = np.stack(np.meshgrid(x, y), axis=-1)
    posture, reached = machine.field(places, working)
    curves = _direct_curves(machine, working) + _stop_curves(scene, machine, working)
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


def _bends_like(theta: Floats, working: Working) -> Flags:
    """Whether postures (..., 4) are in a working mode, its rim included."""
    return np.all(sines(theta)[..., 1:] * np.array([SIGN[bend] for bend in working]) >= -1e-12, axis=-1)


def _stretches(flags: Flags) -> list[slice]:
    """Ranges of at least two points along which the flags are set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [slice(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2]) if end - begin > 1]


def _direct_curves(machine: Machine, working: Working) -> list[Curve]:
    """Pieces of the direct loci that belong to a working mode: in the others the same place may be regular."""
    return [
        Curve("direct", locus.posture, locus.tip[part], locus.theta[part])
        for locus in machine.direct_singularities(CURVE_POINTS)
        for part in _stretches(_bends_like(locus.theta, working))
    ]


def _stop_curves(scene: Scene, machine: Machine, working: Working) -> list[Curve]:
    """Arcs of the tip with a motor at one of its stops and the other within its own."""
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
            curves += [Curve("stop", f"stop.{limit}[{leg + 1}]", tip[part], posture.theta[part]) for part in _stretches(on)]
    return curves


# Largest discs


class _Obstacles:
    """Obstacles to a disc: the circles of inverse singularities, and pieces of curves as chains of straight ones."""

    def __init__(self, circles: list[Circle], chains: list[Floats]):
        self.circles = circles
        self.begin = np.concatenate([chain[:-1] for chain in chains]) if chains else np.zeros((0, 2))
        self.along = np.concatenate([np.diff(chain, axis=0) for chain in chains]) if chains else np.zeros((0, 2))
        self.squared = np.maximum(np.sum(self.along**2, axis=-1), np.finfo(float).tiny)

    def near(self, middle: Floats, radius: float) -> "_Obstacles":
        """Those that may matter within a radius of a place."""
        near = _Obstacles(self.circles, [])
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
        """Distances from the chains: distant places are divided, and each half searches near itself."""
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
        return np.sqrt(np.min((x - share * self.along[:, 0]) ** 2 + (y - share * self.along[:, 1]) ** 2, axis=-1))


def _coarse(chain: Floats) -> tuple[Floats, float]:
    """A chain of every 16th point, and how far it may be from the chain."""
    rows = np.append(np.arange(0, len(chain) - 1, 16), len(chain) - 1)
    lengths = np.hypot(*np.diff(chain, axis=0).T)
    return chain[rows], float(np.add.reduceat(lengths, rows[:-1]).max() / 2)


def _aspects(regions: NDArray[np.int8]) -> list[tuple[int, Flags]]:
    """Connected sets of cells of one kind but 0, by their sides, each with its kind."""
    labels = np.where(regions != 0, np.arange(1, regions.size + 1).reshape(regions.shape), 0)
    while True:
        before = labels.copy()
        for axis in (0, 1):
            low, high = (slice(None, -1), slice(1, None)) if axis == 0 else ((slice(None), slice(None, -1)), (slice(None), slice(1, None)))
            joined = (regions[low] == regions[high]) & (regions[low] != 0)
            smaller = np.minimum(labels[low], labels[high])
            labels[low] = np.where(joined, smaller, labels[low])
            labels[high] = np.where(joined, np.minimum(smaller, labels[high]), labels[high])
        # Each label is the number of a cell, whose own label may have become smaller.
        labels = np.where(labels > 0, labels.ravel()[labels - 1], 0)
        if np.array_equal(labels, before):
            break
    return [(int(regions.ravel()[label - 1]), labels == label) for label in np.unique(labels[labels > 0]).tolist()]


def _discs(scene: Scene, machine: Machine, working: Working, curves: list[Curve], x: Floats, y: Floats) -> list[Disc]:
    """The largest disc of each aspect, a connected region without singularity, and others there that do not touch larger ones; all sorted.

    Those of a few cells are left out.
    """
    circles, chains = machine.inverse_singularities(), [curve.tip for curve in curves]
    coarse = [_coarse(chain) for chain in chains]
    fine, rough = _Obstacles(circles, chains), _Obstacles(circles, [chain for chain, _ in coarse])
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

            def room(middles: Floats, near: _Obstacles, side: int = side, taken: list[Disc] = found) -> Floats:
                """Distance from all obstacles and discs so far, negative outside the region."""
                distance = near.distance(middles)
                distance = np.where(region(middles) == side, distance, -distance)
                for disc in taken:
                    distance = np.minimum(distance, np.hypot(*(middles - np.array(disc[1:3])).T) - disc.radius)
                return distance

            middle, radius = _roomiest(room, start, 2 * cell, rough, fine, slack, DISC_TOLERANCE * machine.size)
            apart = [np.hypot(*(middle - np.array(disc[1:3]))) - disc.radius - radius for disc in found]
            if radius < 2 * cell or min(apart, default=1.0) < 10 * DISC_TOLERANCE * machine.size:
                break
            found.append(Disc("plus" if side > 0 else "minus", *map(float, middle), radius))
        discs += found
    return sorted(discs, key=lambda disc: -disc.radius)


def _roomiest(
    room: Callable[[Floats, _Obstacles], Floats], middles: Floats, size: float, rough: _Obstacles, fine: _Obstacles, slack: float, tolerance: float
) -> tuple[Floats, float]:
    """The place with the most room in square cells about `middles`, and how much there is.

    The room changes by no more than the way that a place moves. So a cell has nowhere more room than at its middle by more than half its
    diagonal: cells that cannot be better than the best so far are dropped, the others divided, until they are small enough. `rough` obstacles
    are off by up to `slack`; `fine` ones take their place where that matters.
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
    """Writes `field.csv`, `loci.csv`, `discs.csv` and, where there is a motion, `path.csv` into a folder; returns the files."""
    directory = FilePath(folder)
    directory.mkdir(parents=True, exist_ok=True)
    angles = [f"{name} [rad]" for name in ANGLES]
    tables: dict[str, tuple[list[str], Iterable[Sequence[object]]]] = {
        "field.csv": (["working", "x [m]", "y [m]", "assembly", *angles, "dexterity [1]", "within_stops", "force [N]"], _field_rows(survey)),
        "loci.csv": (["working", "kind", "detail", "piece", "x [m]", "y [m]", *angles], _locus_rows(survey)),
        "discs.csv": (
            ["working", "assembly", "x [m]", "y [m]", "radius [m]"],
            ([mode.name, disc.assembly, *disc[1:]] for mode in survey.modes for disc in mode.discs),
        ),
    }
    if survey.path is not None:
        rows = np.column_stack([survey.path.time, survey.path.tip, survey.path.theta]).tolist()
        tables["path.csv"] = (["time [s]", "x [m]", "y [m]", *angles], rows)
    for name, (header, rows) in tables.items():
        with (directory / name).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(header)
            writer.writerows([f"{value:.9g}" if isinstance(value, float) else value for value in row] for row in rows)
    return [directory / name for name in tables]


def _field_rows(survey: Map) -> Iterable[list[object]]:
    """One row for each place that is reached."""
    places = np.stack(np.meshgrid(survey.x, survey.y), axis=-1)
    for mode in survey.modes:
        on = mode.reached
        assembly = np.where(sines(mode.theta[on])[:, 0] >= 0, "plus", "minus").tolist()
        force = [""] * len(assembly) if mode.force is None else mode.force[on].tolist()
        columns = (places[on].tolist(), assembly, mode.theta[on].tolist(), mode.dexterity[on].tolist(), mode.within_stops[on].tolist(), force)
        for place, side, theta, dexterity, within, held in zip(*columns):
            yield [mode.name, *place, side, *theta, dexterity, int(within), held]


def _locus_rows(survey: Map) -> Iterable[list[object]]:
    """Curves of each mode, every tenth point; circles of all modes, whose angles depend on the mode."""
    for number, circle in enumerate(survey.circles):
        for angle in np.linspace(-np.pi, np.pi, 361).tolist():
            tip = circle.centre[0] + circle.radius * np.cos(angle), circle.centre[1] + circle.radius * np.sin(angle)
            yield ["", "inverse", f"{('left', 'right')[circle.leg]} {circle.posture}", number, *map(float, tip), "", "", "", ""]
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Maps a scene into a folder."""
    parser = argparse.ArgumentParser(prog="python -m fivebar.workspace", description="Maps where the tip of a scene's machine can go.")
    parser.add_argument("scene", help="name of a scene, or a file")
    parser.add_argument("--out", type=FilePath, metavar="DIR", help="folder of pictures and tables; ./SCENE/ unless told")
    parser.add_argument("--torque", type=float, nargs=2, metavar=("LEFT", "RIGHT"), help="limits of the motors' torques, N·m")
    names = {left + right.capitalize(): (left, right) for left, right in WORKING_MODES}
    parser.add_argument("--mode", choices=names, action="append", help="working mode to map, once or more; all four unless told")
    parser.add_argument("--no-path", action="store_true", help="do not run the scene to show its motion")
    options = parser.parse_args(arguments)
    from fivebar import workspace_pictures

    try:
        scene = scenes.read(options.scene)
        limits = tuple(options.torque) if options.torque else None
        path = None if options.no_path else follow(scene)
        survey = compute(scene, limits, path, modes=[names[name] for name in options.mode or names])
        folder = options.out or FilePath(scene.name)
        files = write(survey, folder) + workspace_pictures.draw(survey, folder)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    print("\n".join([*summary(survey), *map(str, files)]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
