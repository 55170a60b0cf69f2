"""A drawing as a motion of a scene's machine: feasibility, timing, and the scene that draws it.

`plan` times and checks a drawing, `write_scene` writes the scene that draws it, and `compare` evaluates the machine's motion.
The lifting of the pen is only a column of the tables, since the unit is planar.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray

from fivebar import pieces as ways
from fivebar import scene as scenes
from fivebar import table
from fivebar.borders import Obstacles, borders, stop_margin
from fivebar.demand import Demand
from fivebar.errors import FiveBarError
from fivebar.kinematics import SIDES, Machine, Working, mode_name
from fivebar.pieces import Piece, Timing
from fivebar.result import Result
from fivebar.scene import MOST_POINTS, Scene
from fivebar.strokes import Drawing
from fivebar.variables import of_unit

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

CLEARANCE = 1e-6
"""Distance from singular loci and stops, in multiples of the machine's size, below which a path counts as touching them."""

MOST_SPANS = 4096
"""Largest number of spans of a path that are checked together."""

REST = 0.2
"""Seconds of rest before and after the drawing, and whenever the pen goes up or down."""

SLOWEST = 64.0
"""Largest factor by which a piece may be slowed down to respect the motors' limits."""


class Blocked(FiveBarError):
    """The machine cannot draw a drawing; has the place and the reason."""

    def __init__(self, place: Floats, reason: str):
        super().__init__(reason)
        self.place = place
        """Position of the tip, m, shape (2,)."""


@dataclass(frozen=True)
class Limits:
    """Limits of the motors; infinite if there is no limit."""

    rate: float = math.inf
    """Largest rate of the motors, rad/s."""

    torques: tuple[float, float] = (math.inf, math.inf)
    """Largest torques of the left and the right motor, N·m."""


@dataclass(frozen=True)
class Plan:
    """A timed drawing: one row per communication point of the scene, in s, m, rad and N·m."""

    scene: Scene
    """The scene with the drawing machine."""

    machine: Machine
    working: Working
    drawing: Drawing
    timing: Timing
    time: Floats
    """Time, (n,)."""

    tip: Floats
    """Position of the tip, (n, 2)."""

    pen: Flags
    """Whether the pen is down on the way to this row's position, (n,)."""

    theta: Floats
    """Angles of the links 1 to 4, (n, 4)."""

    omega: Floats
    """Rates of the motors, rad/s, (n, 2)."""

    torque: Floats
    """Motor torques that the motion needs, computed by the unit, (n, 2)."""

    slowed: int
    """Number of pieces that are slowed down by the motors' limits."""

    def words(self, name: str) -> str:
        """Length, time and load of the drawing `name`, in sentences."""
        slowed = f" {self.slowed} pieces are slowed down by the motors' limits." if self.slowed else ""
        rate, torque = np.abs(self.omega).max(), np.abs(self.torque).max()
        return (
            f"{name}: {len(self.drawing.strokes)} strokes, {self.drawn:.4g} m of lines in {self.time[-1]:.4g} s, motor rates up to {rate:.3g} rad/s, "
            f"torques up to {torque:.3g} N·m.{slowed}"
        )

    @property
    def drawn(self) -> float:
        """Length of all strokes, m."""
        return float(np.sum(np.hypot(*np.diff(self.tip, axis=0).T)[self.pen[1:]]))


def mode_of(scene: Scene) -> Working:
    """The initial working mode of a scene."""
    machine = Machine.from_scene(scene)
    motors = [float(scene[f"init.theta[{i}]"]) for i in (1, 2)]
    left, right = machine.forward(motors, scene["init.assembly"]).working.tolist()
    return left, right


def servo_limits(scene: Scene) -> tuple[float, float]:
    """Limits of the scene's servos, N·m."""
    return float(scene["servo.limit[1]"]), float(scene["servo.limit[2]"])


def plan(
    scene: Scene, drawing: Drawing, timing: Timing, working: Working | None = None, limits: Limits = Limits()
) -> Plan:
    """The motion with which the scene's machine draws the placed `drawing`, by default in the working mode of the scene's start.

    Pieces run from rest to rest and are slowed down if limits of rate or torque require it. Raises `Blocked` if a stroke, or a
    way between strokes, meets the end of the reach, a stop or a singular locus, or if it needs too much torque even at rest.
    """
    machine, mode, step = Machine.from_scene(scene), working or mode_of(scene), scene.step_size
    sequence = ways.of(drawing.strokes)
    # Chords are cheap to compute and give a lower bound: a drawing that takes too long is refused before the costly steps.
    least = sum(timing.duration(piece.chord) for piece in sequence)
    if least > MOST_POINTS * step:
        raise FiveBarError(
            f"the drawing takes {least:.4g} s or more, but up to {MOST_POINTS * step:g} s are allowed in steps of {step:g} s: "
            "a higher speed or a smaller size makes it shorter"
        )
    check(scene, machine, mode, sequence)
    with Demand(scene, machine.inverse(sequence[0].curves[0, 0], mode).theta) as demand:
        fewest = [max(1, math.ceil(timing.duration(piece.length) / step - 1e-9)) for piece in sequence]
        counts = [
            _enough(piece, timing, count, step, machine, mode, limits, demand) for piece, count in zip(sequence, fewest)
        ]
        tip, velocity, acceleration, pen = _schedule(sequence, timing, counts, step)
        posture = machine.inverse(tip, mode)
        theta = np.unwrap(posture.theta, axis=0) + _turns(scene, posture.theta[0])
        omega = machine.motor_rates(theta, velocity)
        torque = demand.torques(theta, omega, machine.motor_accelerations(theta, velocity, acceleration))
    return Plan(
        scene,
        machine,
        mode,
        drawing,
        timing,
        step * np.arange(len(tip), dtype=float),
        tip,
        pen,
        theta,
        omega,
        torque,
        sum(map(int.__ne__, counts, fewest)),
    )


Rows = tuple[Floats, Floats, Floats, Flags]
"""Place, velocity, acceleration of the tip, and whether the pen is down."""


def _schedule(sequence: list[Piece], timing: Timing, counts: list[int], step: float) -> Rows:
    """All pieces in `counts` steps each, with rests at both ends and at each lift or drop of the pen."""
    rest = max(1, round(REST / step))
    rows = [_rest(sequence[0].curves[0, 0], rest + 1, False)]
    for piece, count, following in zip(sequence, counts, [*sequence[1:], None]):
        rows.append(_rows(piece, timing, count, count * step))
        if following is None or following.pen != piece.pen:
            rows.append(_rest(piece.curves[-1, 3], rest, piece.pen))
    tip, velocity, acceleration, pen = (np.concatenate([row[i] for row in rows]) for i in range(4))
    return tip, velocity, acceleration, pen.astype(bool)


def _rest(place: Floats, count: int, pen: bool) -> Rows:
    return np.tile(place, (count, 1)), np.zeros((count, 2)), np.zeros((count, 2)), np.full(count, pen)


def _rows(piece: Piece, timing: Timing, count: int, duration: float) -> Rows:
    """The rows of a piece without its first point, which belongs to the previous piece."""
    way, rate, change = timing.way(piece.length, np.arange(1, count + 1) / count)
    place, tangent, curvature = piece.at(way)
    rate, change = rate[:, None] / duration, change[:, None] / duration**2
    return place, rate * tangent, change * tangent + rate**2 * curvature, np.full(count, piece.pen)


def _turns(scene: Scene, theta: Floats) -> Floats:
    """Whole turns, rad, to add to link angles (4,) so that the motor angles are nearest to the middle of their stops."""
    turns = np.zeros(4)
    if scene["stop.enabled"]:
        for link, leg in ((0, 1), (3, 2)):
            middle = (float(scene[f"stop.lower[{leg}]"]) + float(scene[f"stop.upper[{leg}]"])) / 2
            turns[link] = 2 * np.pi * np.round((middle - theta[link]) / (2 * np.pi))
    return turns


# Limits


def _enough(
    piece: Piece,
    timing: Timing,
    count: int,
    step: float,
    machine: Machine,
    working: Working,
    limits: Limits,
    demand: Demand,
) -> int:
    """Number of communication steps, at least `count`, with which a piece stays within the motors' limits.

    Rates scale with 1/T and torques beyond the static ones with 1/T² for the duration T (Hollerbach 1984). Friction does not
    follow this law, so each duration is evaluated with the unit.
    """
    most = np.array(limits.torques)

    def load(count: int) -> tuple[float, Floats, Floats]:
        """The largest load as a share of its limit, and the place and torques of the largest torque share."""
        tip, velocity, acceleration, _ = _rows(piece, timing, count, count * step)
        theta = machine.inverse(tip, working).theta
        omega = machine.motor_rates(theta, velocity)
        rate = float(np.abs(omega).max()) / limits.rate
        if not np.any(np.isfinite(most)):
            return rate, tip[0], most
        torques = demand.torques(theta, omega, machine.motor_accelerations(theta, velocity, acceleration))
        shares = np.max(np.abs(torques) / most, axis=-1)
        row = int(np.argmax(shares))
        return max(rate, float(shares[row])), tip[row], torques[row]

    if load(count)[0] <= 1:
        return count
    low, high = count, count
    while high < SLOWEST * count:
        low, high = high, math.ceil(1.5 * high)
        if (found := load(high))[0] <= 1:
            break
    else:
        _, place, torque = found
        leg = int(np.argmax(np.abs(torque) / most))
        raise Blocked(
            place,
            f"{_where(piece, place)} needs {abs(torque[leg]):.4g} N·m of the {SIDES[leg]} motor however slow it is: the limit is {most[leg]:.4g} N·m",
        )
    while high - low > max(1, low // 1000):
        middle = (low + high) // 2
        low, high = (low, middle) if load(middle)[0] <= 1 else (middle, high)
    return high


# Places at which a path is blocked


def check(scene: Scene, machine: Machine, working: Working, sequence: Sequence[Piece]) -> None:
    """Raises `Blocked` for the first point at which pieces meet the end of the reach, a singular locus of the working mode or a stop.

    A span of a curve is free if the distance of its middle from every border exceeds the length of either half. Otherwise it is
    split into halves.
    """
    name = mode_name(working)
    if machine.is_degenerate(working):
        raise FiveBarError(
            f"In working mode {name} every posture of this machine is a direct singularity: it needs another mode"
        )
    start = sequence[0].curves[0, 0]
    if not machine.is_reachable(start):
        raise Blocked(start, _out_of_reach(machine, sequence[0], start))
    curves = borders(scene, machine, working)
    obstacles = Obstacles(machine.inverse_singularities(), [curve.tip for curve in curves])
    if float(stop_margin(scene, machine.inverse(start, working).motors)) < 0:
        raise Blocked(start, f"{_where(sequence[0], start)} has a motor beyond its stops in working mode {name}")
    spans = np.concatenate([piece.curves for piece in sequence])
    owners = np.repeat(np.arange(len(sequence)), [len(piece.curves) for piece in sequence])
    found = _first_touch(obstacles, spans, owners, CLEARANCE * machine.size)
    if found is None:
        return
    place, owner = found
    piece = sequence[owner]
    legs = [
        circle
        for circle in machine.inverse_singularities()
        if abs(np.hypot(*(place - circle.centre)) - circle.radius) < 4 * CLEARANCE * machine.size
    ]
    if legs:
        circle = legs[0]
        raise Blocked(
            place,
            f"{_where(piece, place)} reaches the limit of the {SIDES[circle.leg]} leg: {circle.radius:.6g} m from its motor "
            f"the leg is {circle.posture}",
        )
    nearest = min(curves, key=lambda curve: float(Obstacles([], [curve.tip]).distance(place[None])[0]))
    if nearest.kind == "stop":
        raise Blocked(place, f"{_where(piece, place)} meets {nearest.detail} = {float(scene[nearest.detail]):.6g} rad")
    raise Blocked(
        place,
        f"{_where(piece, place)} meets a direct singularity of working mode {name}: the distal links are {nearest.detail}",
    )


def _first_touch(
    obstacles: Obstacles, spans: Floats, owners: NDArray[np.int_], tolerance: float
) -> tuple[Floats, int] | None:
    """The first point of curves (n, 4, 2) that is nearer to a border than a tolerance, m, and its owner; None if there is none."""
    while len(spans):
        if len(spans) > MOST_SPANS:
            half = len(spans) // 2
            return _first_touch(obstacles, spans[:half], owners[:half], tolerance) or _first_touch(
                obstacles, spans[half:], owners[half:], tolerance
            )
        left, right = _halves(spans)
        # A curve is no longer than its control polygon.
        extent = np.maximum(
            *(np.sum(np.linalg.norm(np.diff(part, axis=1), axis=-1), axis=-1) for part in (left, right))
        )
        unclear = obstacles.distance(left[:, 3]) <= extent
        touching = unclear & (extent < tolerance)
        if np.any(touching):
            first = int(np.argmax(touching))
            if not np.any(unclear[:first]):
                return left[first, 3], int(owners[first])
            unclear[first + 1 :] = False
        spans = np.stack([left[unclear], right[unclear]], axis=1).reshape(-1, 4, 2)
        owners = np.repeat(owners[unclear], 2)
    return None


def _halves(curves: Floats) -> tuple[Floats, Floats]:
    """Both halves of curves (n, 4, 2), by de Casteljau's algorithm."""
    a, b, c, d = np.moveaxis(curves, 1, 0)
    ab, bc, cd = (a + b) / 2, (b + c) / 2, (c + d) / 2
    abc, bcd = (ab + bc) / 2, (bc + cd) / 2
    middle = (abc + bcd) / 2
    return np.stack([a, ab, abc, middle], axis=1), np.stack([middle, bcd, cd, d], axis=1)


def _where(piece: Piece, place: Floats) -> str:
    what = f"Stroke {piece.stroke}" if piece.pen else f"The way with lifted pen to stroke {piece.stroke}"
    return f"{what}, at ({place[0]:.6g}, {place[1]:.6g}) m,"


def _out_of_reach(machine: Machine, piece: Piece, place: Floats) -> str:
    shortfall = machine.shortfall(place)
    leg = int(np.argmax(np.abs(shortfall)))
    return f"{_where(piece, place)} is {abs(shortfall[leg]):.4g} m too {'far for' if shortfall[leg] > 0 else 'near to'} the {SIDES[leg]} leg"


# The scene, and the motion of its machine


def write_scene(made: Plan, file: FilePath, name: str) -> None:
    """Writes the scene that draws a plan: the scene's machine with tip commands for its servos. `name` is the name of the drawing.

    Signals and further runs of the original scene are left out.
    """
    values = {
        key: value
        for key, value in made.scene.values.items()
        if not key.startswith(("init.", "servo.theta", "servo.omega"))
    }
    values |= made.scene.offsets
    text = f"The machine of {made.scene.name} draws {name}: {made.drawn:.3g} m of lines in {made.time[-1]:.4g} s, in working mode {mode_name(made.working)}."
    kept = _knots(made.tip)
    knots = {
        f"tip.{axis}": {"linear": list(zip(made.time[kept].tolist(), made.tip[kept, i].tolist()))}
        for i, axis in enumerate("xy")
    }
    try:
        stop, step = float(made.time[-1]), made.scene.step_size
        content = scenes.content(text, values, stop, step, of_unit(), knots, made.working)
        scenes.write_content(file, content)
    except FiveBarError as error:
        raise FiveBarError(
            f"{error}; a higher speed, or a larger experiment.stepSize of the machine's scene, makes it smaller"
        ) from None


def _knots(tip: Floats) -> Flags:
    """Rows of a motion (n, 2) that linear interpolation needs: the rows with a change of velocity."""
    change = np.any(np.abs(np.diff(tip, 2, axis=0)) > 1e-15, axis=-1)
    return np.concatenate([[True], change, [True]])


@dataclass(frozen=True)
class Outcome:
    """Motion of the machine, simulated by the unit: one row per communication point."""

    plan: Plan
    tip: Floats
    """Position of the tip, m, (n, 2)."""

    torque: Floats
    """Servo torques, N·m, (n, 2)."""

    late: Floats
    """Distance of the tip from the position commanded for that time, m, (n,)."""

    off: Floats
    """Distance of the tip from the nearest stroke, m, (n,): with the pen down, the visible error on paper."""

    def words(self) -> str:
        """A sentence with largest and root mean square errors with the pen down."""
        pen = self.plan.pen
        off, late = (1e3 * error[pen] for error in (self.off, self.late))
        return (
            f"Distance of the tip from the drawing with the pen down: up to {off.max():.3g} mm, {np.sqrt(np.mean(off**2)):.3g} mm rms; "
            f"from the commanded position: up to {late.max():.3g} mm, {np.sqrt(np.mean(late**2)):.3g} mm rms."
        )


def compare(made: Plan, result: Result) -> Outcome:
    """Compares a run of the plan's scene with the plan."""
    if result.failure is not None:
        raise FiveBarError(f"the machine did not finish its drawing: {result.failure}")
    tip = np.stack([result["tip.x"], result["tip.y"]], axis=-1)
    torque = np.stack([result[f"servo.torque[{i}]"] for i in (1, 2)], axis=-1)
    return Outcome(
        made, tip, torque, np.hypot(*(tip - made.tip).T), Obstacles([], strokes_of(made.tip, made.pen)).distance(tip)
    )


def strokes_of(tip: Floats, pen: Flags) -> list[Floats]:
    """The parts of a motion (n, 2) with the pen down."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], pen, [False]]).astype(int)))
    return [tip[max(begin - 1, 0) : end] for begin, end in zip(edges[::2], edges[1::2])]


def write_table(made: Plan, outcome: Outcome | None, file: FilePath) -> FilePath:
    """Writes plan and outcome as CSV with one row per communication point, in s, m, rad, rad/s and N.m; returns the file."""
    columns = {"time": made.time, "pen": made.pen.astype(int)}
    columns |= {f"tip.{axis}": made.tip[:, i] for i, axis in enumerate("xy")}
    columns |= {f"theta[{leg}]": made.theta[:, link] for leg, link in ((1, 0), (2, 3))}
    columns |= {f"omega[{leg}]": made.omega[:, leg - 1] for leg in (1, 2)}
    columns |= {f"torque[{leg}]": made.torque[:, leg - 1] for leg in (1, 2)}
    if outcome is not None:
        columns |= {f"done.{axis}": outcome.tip[:, i] for i, axis in enumerate("xy")}
        columns |= {f"servo.torque[{leg}]": outcome.torque[:, leg - 1] for leg in (1, 2)}
        columns |= {"off": outcome.off, "late": outcome.late}
    table.write_columns(file, columns)
    return file
