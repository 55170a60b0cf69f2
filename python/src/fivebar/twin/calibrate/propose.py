"""Proposes a motion to identify the remaining unknowns: the candidate that identifies most of them, with the smallest error bars.

Each candidate is planned for the scene's machine and run with the scene's values. The motors follow sums of two sines about the posture that is
nearest to the scene's start and keeps the links out of line. They use the scene's servos, or else soft ones (`SOFT`). The motion ends at its
start, so that a twin repeats it.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fivebar import kinematics
from fivebar.library import Library
from fivebar.scene_file import OFFSETS
from fivebar.twin.calibrate.data import Data, Samples
from fivebar.twin.calibrate.fit import LIMIT, TIGHT, Fitter, Piece, pack
from fivebar.twin.calibrate.identify import without_starts
from fivebar.twin.calibrate.motion import LOST, Machine, Path, Start
from fivebar.twin.calibrate.parameters import Parameter, Values
from fivebar.twin.recording import Array

SECONDS: Final = 4.0
EASED: Final = 1.0
"""Time in which the sines grow at the start and fade at the end, s, to avoid jerks."""

STEP: Final = 0.01
AMPLITUDES: Final = (0.5, 0.35, 0.25, 0.15)
"""Amplitudes of the larger sine of a motor, rad; the smaller one has 0.4 times the amplitude and about 2.3 times the frequency."""

FREQUENCIES: Final = (0.5, 1.0, 2.0)
"""Frequencies of the larger sine, Hz."""

CLEAR: Final = 0.4
"""Desired `clearance`. With distal links in line, the motors do not determine the motion, and a fit may lose it."""

CLOSEST: Final = 0.15
"""Minimum `clearance` of the actual motion, which lags behind its references with soft servos."""

GRID: Final = math.radians(10.0)
"""Grid distance of the tried postures for each motor, rad."""

FINER: Final = 0.5
"""Maximum ratio of expected to present error bars; above it, a motion does not improve an unknown."""

SOFT: Final = {"kp": 5.0, "kd": 0.1}
NAMES: Final = ("servo.theta[1]", "servo.theta[2]", "servo.omega[1]", "servo.omega[2]")


@dataclass(frozen=True)
class Motion:
    """A motion, and the expected error bars from its record."""

    amplitude: float
    frequency: float
    values: Values
    """Start values of the scene."""

    time: Array
    """s, (n)."""

    angles: Array
    """References of the motors, rad, (n, 2)."""

    sigma: Array
    """Standard deviations of the unknowns, in sizes."""

    def improved(self, present: Array) -> list[int]:
        """Unknowns that a record of the motion would identify, with much smaller standard deviations than `present`."""
        return np.flatnonzero(self.sigma < np.minimum(LIMIT, FINER * present)).tolist()

    def signals(self) -> dict[str, Any]:
        """The motion as signals of a scene."""
        knots = {
            f"servo.theta[{i + 1}]": {
                "linear": [[round(float(t), 4), float(a)] for t, a in zip(self.time, self.angles[:, i], strict=True)]
            }
            for i in (0, 1)
        }
        return knots | {f"servo.omega[{i}]": {"rateOf": f"servo.theta[{i}]"} for i in (1, 2)}


def waves(amplitude: float, frequency: float) -> tuple[Array, Array]:
    """Times, s, and references of both motors relative to their posture, rad; they start and end at rest in the posture."""
    time = np.arange(0.0, SECONDS + STEP / 2, STEP)
    turn = 2 * math.pi * frequency
    # The motors rest in the first and last step: rates start and end with 0, so that a twin repeats the motion.
    eased = np.clip((np.minimum(time, SECONDS - time) - STEP) / EASED, 0.0, 1.0)
    grown = np.sin(0.5 * math.pi * eased) ** 2
    columns = []
    for i, (rate, second) in enumerate(((1.0, 2.3), (1.17, 2.7))):
        wave = np.sin(turn * rate * time) + 0.4 * np.sin(turn * second * time)
        columns.append(amplitude * grown * wave)
    return time, np.column_stack(columns)


def propose(
    library: Library,
    scene: Values,
    sought: Sequence[Parameter],
    taken: Array,
    noise: Array,
    present: Array,
) -> Motion | None:
    """The motion that identifies most unknowns, with much smaller standard deviations than `present`; None if no motion identifies any.

    `noise` is the standard deviation of each encoder, rad; `taken` are the prior standard deviations of the scene's values, in sizes.
    """
    whole = dict(library.known.start) | scene
    best: Motion | None = None
    merits = 0, -math.inf
    for amplitude, frequency in itertools.product(AMPLITUDES, FREQUENCIES):
        motion = _tried(library, scene, whole, sought, taken, noise, amplitude, frequency)
        if motion is not None:
            # First the number of identified unknowns counts, then the size of the error bars.
            improved = motion.improved(present)
            merit = len(improved), -float(np.sum(np.log(motion.sigma[improved])))
            if merit[0] and merit > merits:
                best, merits = motion, merit
    return best


def centre(whole: Values, waves: Array) -> Array:
    """Motor angles, rad, nearest to the start at which the waves, (n, 2), keep the clearance `CLEAR`; otherwise with the largest clearance."""
    begin = np.array([float(whole[f"init.theta[{i}]"]) for i in (1, 2)])
    steps = GRID * np.arange(-round(math.pi / GRID), round(math.pi / GRID) + 1)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    grid = grid[np.argsort(np.hypot(*grid.T), kind="stable")]
    least = np.min(clearance(whole, begin + grid[:, None] + waves), axis=1)
    return np.asarray(begin + grid[int(np.argmax(np.minimum(least, CLEAR)))])


def clearance(whole: Values, theta: Array) -> Array:
    """Distance of the machine at motor angles (..., 2) from distal links in line, from stops and from the contact plane; < 0 if the loop does not close.

    It is the minimum of: sine of the angle between the distal links, angles to the stops, and the tip's distance from the plane over the mean link length.
    """
    five = kinematics.Machine.from_values({name: float(whole[name]) for name in kinematics.GEOMETRY})
    proximal_left, left, right, proximal_right = five.lengths
    elbows = proximal_left * np.exp(1j * theta[..., 0]), five.distance + proximal_right * np.exp(1j * theta[..., 1])
    cosine = (left**2 + right**2 - np.abs(elbows[1] - elbows[0]) ** 2) / (2 * left * right)
    closes = np.abs(cosine) < 1.0
    distances = [np.sqrt(1.0 - cosine[closes] ** 2)]
    if whole["stop.enabled"]:
        for i in (1, 2):
            motor = theta[closes][:, i - 1]
            distances += [motor - float(whole[f"stop.lower[{i}]"]), float(whole[f"stop.upper[{i}]"]) - motor]
    if whole["contact.enabled"]:
        tip = five.forward(theta[closes], "plus" if whole["init.assembly"] == 1 else "minus").tip
        apart = tip @ [float(whole[f"contact.n{axis}"]) for axis in "xy"] - float(whole["contact.offset"])
        distances.append(apart / float(np.mean(five.lengths)))
    found = np.full(cosine.shape, -1.0)
    found[closes] = np.min(distances, axis=0)
    return found


def _tried(
    library: Library,
    scene: Values,
    whole: Values,
    sought: Sequence[Parameter],
    taken: Array,
    noise: Array,
    amplitude: float,
    frequency: float,
) -> Motion | None:
    time, around = waves(amplitude, frequency)
    begin = centre(whole, around)
    if np.min(clearance(whole, begin + around)) < CLOSEST:
        return None
    # Only the servos drive the motors, without external forces.
    values = {
        name: value for name, value in scene.items() if name in OFFSETS or library.known[name].causality != "input"
    }
    values |= {"servo.enabled": True, "init.omega[1]": 0.0, "init.omega[2]": 0.0}
    for i, angle in enumerate(begin.tolist(), 1):
        values[f"init.theta[{i}]"] = angle
        if not (whole["servo.enabled"] and whole[f"servo.kp[{i}]"]):
            values |= {f"servo.{gain}[{i}]": value for gain, value in SOFT.items()}
    angles = begin + around
    x = np.array([parameter.origin for parameter in sought])
    machine = Machine(library, values, sought)
    machine.tolerance(TIGHT)
    commands = np.column_stack([angles + machine.offsets(x), np.gradient(angles, time, axis=0)])
    samples = Samples(time, angles, commands, NAMES)
    piece = Piece(
        Path(samples, "linear", library, STEP),
        Start(np.array([*begin, 0.0, 0.0]), int(whole["init.assembly"])),
        np.ones_like(angles, dtype=bool),
    )
    try:
        moved, _ = machine.run(piece.path, x, piece.start)
        if np.any(moved == LOST) or np.min(clearance(whole, moved[:, :2])) < CLOSEST:
            return None
        fitter = Fitter(machine, Data([samples], []), "linear", 2 * SECONDS, lambda _: None)
        [derivative] = fitter.derivatives([piece], pack(x, [piece]))
    finally:
        machine.close()
    weighted = (derivative / noise[:, None]).reshape(-1, derivative.shape[2])
    information = without_starts(weighted, len(sought))
    # The information of one pass sampled every `STEP`; repeated motions give more.
    total = information.T @ information + np.diag(1e-12 + taken**-2)
    sigma = np.sqrt(np.maximum(np.diag(np.linalg.pinv(total, rcond=1e-13)), 0.0))
    # The pseudo-inverse drops unidentified directions, so that their error bars would be 0.
    sizes, directions = np.linalg.eigh(total)
    lost = directions[:, sizes < max(sizes.max() * 1e-12, 1 / LIMIT**2)]
    sigma[np.sum(lost**2, axis=1) > 0.01] = np.inf
    return Motion(amplitude, frequency, values, time, angles, sigma)
