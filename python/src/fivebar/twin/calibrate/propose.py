"""A motion that identifies unknowns which a record did not: of some motions the one with which the unknowns' error bars become least.

Each motion is run with the unknowns as they were found; its information is added to the record's. Motors are led on sums of two sines
by the servos that the scene has, or else soft ones of 2 N.m/rad and 0.02 N.m.s/rad.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fivebar.twin.calibrate.data import Data, Samples
from fivebar.twin.calibrate.fit import Fit, Fitter, Piece, pack
from fivebar.twin.calibrate.identify import LIMIT, without_starts
from fivebar.twin.calibrate.motion import LOST, Machine, Path, Start
from fivebar.twin.calibrate.parameters import Parameter, Values
from fivebar.twin.recording import Array
from fivebar.twin.unit import UnitError

SECONDS: Final = 3.0
STEP: Final = 0.01
MOTIONS: Final = tuple((amplitude, frequency) for amplitude in (0.25, 0.5) for frequency in (0.5, 1.0, 2.0))
"""Of the larger sine of a motor, rad and Hz; its smaller one has 0.4 of the amplitude and 2.3 times the frequency."""

SOFT: Final[Values] = {"servo.enabled": True} | {
    f"servo.{name}[{i}]": value for name, value in (("kp", 2.0), ("kd", 0.02)) for i in (1, 2)
}
NAMES: Final = ("servo.theta[1]", "servo.theta[2]", "servo.omega[1]", "servo.omega[2]")


@dataclass(frozen=True)
class Motion:
    """A motion, and the error bars expected of a record of it together with the present one."""

    amplitude: float
    frequency: float
    values: Values
    """Start values of its scene beside the unknowns."""

    sigma: Array
    """Standard deviations of the unknowns, in sizes."""

    def told(self, refused: Sequence[int]) -> list[int]:
        """Those of the refused unknowns that a record of the motion would identify."""
        return [k for k in refused if self.sigma[k] < LIMIT]

    def signals(self) -> dict[str, Any]:
        """As scenes have them."""
        time, angles = references(self)
        knots = {
            f"servo.theta[{i + 1}]": {
                "linear": [[round(float(t), 4), float(a)] for t, a in zip(time, angles[:, i], strict=True)]
            }
            for i in (0, 1)
        }
        return knots | {f"servo.omega[{i}]": {"rateOf": f"servo.theta[{i}]"} for i in (1, 2)}


def references(motion: Motion) -> tuple[Array, Array]:
    """Times, s, and references of both motors, rad. Both begin at rest where the machine does."""
    time = np.arange(0.0, SECONDS + STEP / 2, STEP)
    turn = 2 * math.pi * motion.frequency
    # A second of growing, so that the machine is not jerked.
    grows = np.minimum(time, 1.0)
    columns = []
    for i, (rate, second) in enumerate(((1.0, 2.3), (1.17, 2.7))):
        wave = np.sin(turn * rate * time) + 0.4 * np.sin(turn * second * time)
        columns.append(float(motion.values[f"init.theta[{i + 1}]"]) + motion.amplitude * grows * wave)
    return time, np.column_stack(columns)


def propose(machine: Machine, fit: Fit, refused: Sequence[int]) -> Motion | None:
    """The motion that tells most of the refused unknowns; None if none of them is told by any."""
    sought = list(machine.sought)
    weights = 1 / fit.sigma[fit.rows[:, 2]]
    known = without_starts(fit.jacobian * weights[:, None], len(sought))
    information = known.T @ known + np.eye(len(sought)) * 1e-12
    best: Motion | None = None
    for amplitude, frequency in MOTIONS:
        motion = _tried(machine, fit, sought, information, amplitude, frequency)
        if motion is None or not motion.told(refused):
            continue
        if best is None or _merit(motion, refused) > _merit(best, refused):
            best = motion
    return best


def _merit(motion: Motion, refused: Sequence[int]) -> tuple[int, float]:
    """More unknowns told first, then smaller bars."""
    return len(motion.told(refused)), -float(np.sum(np.log(motion.sigma[list(refused)])))


def _tried(
    machine: Machine, fit: Fit, sought: list[Parameter], information: Array, amplitude: float, frequency: float
) -> Motion | None:
    first = fit.pieces[0]
    servo = {} if machine.scene.get("servo.enabled") else SOFT
    begin = {f"init.theta[{i + 1}]": float(first.start.state[i]) for i in (0, 1)} | {
        "init.assembly": first.start.assembly
    }
    motion = Motion(amplitude, frequency, dict(servo) | begin, np.empty(0))
    time, angles = references(motion)
    commands = np.column_stack([angles + machine.offsets(fit.x), np.gradient(angles, time, axis=0)])
    samples = Samples(time, angles, commands, NAMES)
    other = Machine(machine.library, machine.scene | servo, sought)
    try:
        fitter = Fitter(other, Data([samples], []), "linear", 2 * SECONDS, lambda _: None)
        piece = Piece(
            Path(samples, "linear", machine.library, STEP),
            Start(np.array([*first.start.state[:2], 0.0, 0.0]), first.start.assembly),
            np.ones_like(angles, dtype=bool),
        )
        z = pack(fit.x, [piece])
        if not np.all(np.abs(fitter.motion(piece, fit.x, piece.start.state)) < 0.5 * LOST):
            return None
        derivative = fitter.derivatives([piece], z, central=False)[0] / fit.sigma[:, None]
    except UnitError:
        return None
    finally:
        other.close()
    told = without_starts(derivative.reshape(-1, derivative.shape[2]), len(sought))
    # As many samples a second as the record has.
    rate = STEP / fitter_period(fit)
    total = information + rate * told.T @ told
    sigma = np.sqrt(np.maximum(np.diag(np.linalg.pinv(total, rcond=1e-13)), 0.0))
    # Directions that a pseudo-inverse drops are not identified, but would have a bar of 0.
    values, vectors = np.linalg.eigh(total)
    lost = vectors[:, values < max(values.max() * 1e-12, 1 / LIMIT**2)]
    sigma[np.sum(lost**2, axis=1) > 0.01] = np.inf
    return Motion(amplitude, frequency, motion.values, sigma)


def fitter_period(fit: Fit) -> float:
    """The usual distance of two samples, s."""
    return float(np.median(np.diff(fit.pieces[0].path.time)))
