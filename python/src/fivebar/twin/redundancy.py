"""Redundant information in a recording: the order, signs and zeros of the encoders, checked against all other measurements.

An `Assignment` is one choice of order and signs of the encoders. Each kind of evidence (angles of the distal links, a tracked tip, commands,
torques at rest, the reach of the machine) gives each assignment a misfit, with fitted zeros if it depends on them. The scene's lengths (to
`estimator.sigma0.length`), assembly, commands and torques are assumed to be right.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from scipy import optimize

from fivebar.kinematics import Machine, Sign
from fivebar.plain import plain
from fivebar.scene import Scene
from fivebar.statics import holding_torques
from fivebar.twin.importing.maps import PASSIVE
from fivebar.twin.messages import MEASURED, TRACKED
from fivebar.twin.recording import Array, Recording

TURN: Final = 2 * np.pi

SAMPLES: Final = 60
"""Number of samples in the coarse search, spread over the record; the fit uses ten times as many."""

COARSE: Final = 36
"""Zeros tried for each encoder: every 10 degrees, a tenth of the width in which a fit converges."""

STARTS: Final = 4
"""Number of best coarse zeros from which a fit starts."""

CLOSES: Final = 0.98
"""Minimum share of samples with a closed loop; the rest may be outliers."""

ALIKE: Final = 2.0
"""Ratio of misfits up to which two assignments fit equally well."""

FLOOR: Final = 5e-4
"""Misfit, rad, below which every assignment fits: the resolution of a coarse encoder."""

WORST: Final = 0.01
"""Misfit, rad, that reveals another machine than the scene's. Fitted zeros hide most of the effect of wrong lengths; lengths 25 % off leave this misfit."""

UNLIKE: Final = 0.5
"""Misfit relative to the variation of the data, above which there is no resemblance."""

MOVES: Final = 0.05
"""Minimum motion of a command for evidence, rad."""

SURE: Final = 0.02
"""Maximum standard deviation of an identified zero, rad."""

LENGTHS: Final = "for length errors of estimator.sigma0.length"
"""Assumption behind zeros that a closed loop shows."""

DEFLECTED: Final = 1e-6
"""Smallest mean deflection of a servo that is named, rad; zeros are printed in steps of 1e-4 rad."""

REGULAR: Final = 0.05
"""Minimum sine between the distal links: nearer to a direct singularity, torques grow without bound."""

CLOSED_OFF: Final = 1.0
"""Residual, rad, of a posture without a closed loop."""


Residuals = Callable[["_Loop", Array, Array], Array]
"""Function from a loop's motor angles (..., n, 2) at n samples to residuals (..., n, m); NaN if the loop does not close."""


class Assignment(NamedTuple):
    """Order and signs of the encoders: motor angle = sign x encoder angle + zero."""

    exchanged: bool
    signs: tuple[int, int]
    """Signs of the left and the right angle."""

    def angles(self, encoders: Array) -> Array:
        """Motor angles, rad, (n, 2), without zeros."""
        ordered = encoders[:, ::-1] if self.exchanged else encoders
        return np.asarray(ordered * np.array(self.signs))

    def words(self) -> str:
        """Description for a sentence."""
        reversed_ = [side for side, sign in zip(("left", "right"), self.signs, strict=True) if sign < 0]
        words = (["encoders exchanged"] if self.exchanged else []) + [f"{side} angle reversed" for side in reversed_]
        return " and ".join(words) or "encoders as in the map"


ASSIGNMENTS: Final = tuple(
    Assignment(exchanged, (left, right)) for exchanged, left, right in product((False, True), (1, -1), (1, -1))
)
"""All assignments; the first one is the assignment of the map."""


@dataclass(frozen=True)
class Fit:
    """Fit of an assignment to a kind of evidence."""

    misfit: float
    """rms, in the unit of the evidence; inf if the assignment is impossible."""

    zeros: Array
    """Zeros to add to the angles, rad, (2)."""

    sigma: Array
    """Standard deviations of the zeros, rad, (2), including the length errors `estimator.sigma0.length`; inf if not identified."""


@dataclass(frozen=True)
class Evidence:
    """A kind of evidence, with its fits."""

    name: str
    unit: str
    """Unit of the misfits."""

    fits: tuple[Fit, ...]
    """Fits in the order of `ASSIGNMENTS`."""

    floor: float
    """Misfit below which an assignment always fits."""

    most: float
    """Maximum misfit of the best assignment; above it, the machine is another one or was moved by hand."""

    bases: tuple[str, str] = (LENGTHS, LENGTHS)
    """For each motor angle, the assumption behind its zero, or ""."""

    @property
    def is_believed(self) -> bool:
        """Whether any assignment fits."""
        return min(fit.misfit for fit in self.fits) <= self.most

    def fitting(self) -> frozenset[int]:
        """Indices of the assignments that fit about as well as the best one."""
        best = min(fit.misfit for fit in self.fits)
        most = max(ALIKE * best, self.floor)
        return frozenset(k for k, fit in enumerate(self.fits) if np.isfinite(fit.misfit) and fit.misfit <= most)


@dataclass(frozen=True)
class Passive:
    """The measured angle of a distal link: its column, sign and zero."""

    column: int
    """Index in `maps.PASSIVE`."""

    sign: int
    zero: float
    """Zero, rad."""


@dataclass(frozen=True)
class Verdict:
    """Conclusions from a recording."""

    evidence: tuple[Evidence, ...]
    possible: tuple[int, ...]
    """Indices of the assignments without contradicting evidence, the chosen one first."""

    zeros: Array
    """Zeros of the chosen assignment, rad, (2); 0 if not identified."""

    sigma: Array
    """Standard deviations of the zeros, rad, (2); inf if not identified."""

    bases: tuple[str, str]
    """For each motor angle, the assumption behind its zero."""

    passive: tuple[Passive, Passive] | None
    """Left and right distal link, if both are recorded and fit."""

    beyond: float
    """Share of the samples beyond the reach of the machine, by the chosen assignment and its zeros."""

    @property
    def chosen(self) -> Assignment:
        """The proposed assignment: the assignment of the map, if it is possible."""
        return ASSIGNMENTS[self.possible[0]]


def weigh(given: Recording, scene: Scene, relative: tuple[bool, bool] = (False, False)) -> Verdict:
    """Draws conclusions from a recording with both encoders. `relative`: whether each distal angle counts from its proximal link."""
    loop = _Loop(given, scene, relative)
    evidence = []
    if loop.passive is not None:
        evidence.append(loop.closure("angles of the distal links", "rad", _Loop.passive_residuals))
    if loop.tip is not None:
        evidence.append(loop.closure("the tracked tip", "of a link's length", _Loop.tip_residuals))
    if loop.weighs:
        evidence.append(loop.closure("torques at rest", "of their variation", _Loop.torque_residuals, 0.1, UNLIKE))
    if loop.commands is not None:
        evidence.append(loop.commanded())
    # Reach is only used alone: other evidence fits zeros, and with them all samples are within reach.
    evidence = evidence or [loop.reach()]
    possible = frozenset(range(len(ASSIGNMENTS)))
    believed = [each for each in evidence if each.is_believed]
    for each in believed:
        # Evidence that contradicts all remaining assignments is ignored: earlier evidence is stronger.
        possible = possible & each.fitting() or possible
    order = tuple(sorted(possible))
    zeros, sigma, bases = np.zeros(2), np.full(2, np.inf), [LENGTHS, LENGTHS]
    for each in believed:
        fit = each.fits[order[0]]
        better = (fit.sigma < SURE) & ~np.isfinite(sigma)
        bases = [new if is_better else old for new, old, is_better in zip(each.bases, bases, better, strict=True)]
        zeros, sigma = np.where(better, fit.zeros, zeros), np.where(better, fit.sigma, sigma)
    chosen = ASSIGNMENTS[order[0]]
    passive = loop.legs(chosen, zeros) if loop.passive is not None and evidence[0].is_believed else None
    beyond = loop.beyond(chosen.angles(loop.encoders) + zeros)
    return Verdict(tuple(evidence), order, zeros, sigma, (bases[0], bases[1]), passive, beyond)


class _Loop:
    """The kinematic loop of the machine at the samples of a recording."""

    def __init__(self, given: Recording, scene: Scene, relative: tuple[bool, bool]):
        self.scene, self.machine = scene, Machine.from_scene(scene)
        self.sigma_length = float(scene["estimator.sigma0.length"])
        self.side: Sign = scene["init.assembly"]
        columns = given.columns
        encoders = np.column_stack([columns[name] for name in MEASURED])
        known = np.flatnonzero(np.isfinite(encoders).all(axis=1))
        self.known = known[np.linspace(0, len(known) - 1, min(len(known), 10 * SAMPLES)).astype(int)]
        self.encoders = encoders[self.known]
        self.rates = self._rates(given, encoders)

        def taken(names: tuple[str, ...]) -> Array | None:
            if not all(name in columns and np.isfinite(columns[name]).any() for name in names):
                return None
            return np.column_stack([columns[name][self.known] for name in names])

        self.passive, self.tip = taken(PASSIVE), taken(TRACKED)
        if self.passive is not None:
            self.passive = self.passive - np.where(relative, self.encoders, 0.0)
        self.relative = np.array(relative)
        self.torques = taken(("tau[1]", "tau[2]"))
        commands = taken(("servo.theta[1]", "servo.theta[2]"))
        self.commands = commands if commands is not None and np.all(np.ptp(commands, axis=0) > MOVES) else None
        self.weighs = (
            bool(scene["gravity.enabled"])
            and self.torques is not None
            and bool(np.all(np.std(self.torques, axis=0) > 0))
        )

    def _rates(self, given: Recording, encoders: Array) -> Array:
        """Speed of the faster encoder at the samples, rad/s."""
        ends = np.clip(np.stack([self.known - 1, self.known + 1]), 0, len(given.time) - 1)
        apart = np.abs(encoders[ends[1]] - encoders[ends[0]]).max(axis=1)
        return np.asarray(
            np.nan_to_num(apart / np.maximum(given.time[ends[1]] - given.time[ends[0]], 1e-9), nan=np.inf)
        )

    def postures(self, motors: Array) -> tuple[Array, Array, Array]:
        """For motor angles (..., 2): whether the loop closes, link angles (..., 4) and tip (..., 2); NaN if it does not."""
        l1, l2, l3, l4 = self.machine.lengths
        left, right = (length * np.exp(1j * motors[..., i]) for i, length in ((0, l1), (1, l4)))
        apart = np.abs(right + self.machine.distance - left)
        closes = (apart < l2 + l3) & (apart > max(abs(l2 - l3), 1e-6 * (l2 + l3)))
        theta, tip = np.full((*motors.shape[:-1], 4), np.nan), np.full(motors.shape, np.nan)
        if closes.any():
            found = self.machine.forward(motors[closes], self.side)
            theta[closes], tip[closes] = found.theta, found.tip
        return closes, theta, tip

    def beyond(self, motors: Array) -> float:
        """Share of the samples for which the loop does not close."""
        return 1 - float(np.mean(self.postures(motors)[0]))

    def longer(self) -> "list[_Loop]":
        """Loops in which one length is increased by its standard deviation, one loop for each length."""
        values = [self.machine.distance, *self.machine.lengths]
        loops = []
        for k in range(len(values)):
            distance, l1, l2, l3, l4 = (x + self.sigma_length * (i == k) for i, x in enumerate(values))
            loop = copy(self)
            loop.machine = Machine(distance, (l1, l2, l3, l4))
            loops.append(loop)
        return loops

    # Residuals

    def passive_residuals(self, motors: Array, rows: Array) -> Array:
        """Residuals of the distal links' angles, minus their means because their zeros are free, with the best order and signs."""
        _, theta, _ = self.postures(motors)
        found = self._legs(theta, rows)
        swapped = np.sum(found[1] ** 2, axis=(-2, -1)) < np.sum(found[0] ** 2, axis=(-2, -1))
        return np.where(swapped[..., None, None], found[1], found[0])

    def _legs(self, theta: Array, rows: Array) -> tuple[Array, Array]:
        """Residuals of both legs with the columns in order and exchanged, each with its better sign."""
        assert self.passive is not None
        found = []
        for order in ((0, 1), (1, 0)):
            legs = []
            for leg, column in enumerate(order):
                model = theta[..., 1 + leg] - (theta[..., 3 * leg] if self.relative[column] else 0.0)
                either = [_wrapped_about_mean(model - sign * self.passive[rows, column]) for sign in (1, -1)]
                one, other = (np.nan_to_num(np.sum(each**2, axis=-1), nan=np.inf) for each in either)
                legs.append(np.where((one <= other)[..., None], *either))
            found.append(np.stack(legs, axis=-1))
        return found[0], found[1]

    def tip_residuals(self, motors: Array, rows: Array) -> Array:
        """Residuals of the tip relative to the mean length of the links."""
        assert self.tip is not None
        return np.asarray((self.postures(motors)[2] - self.tip[rows]) / np.mean(self.machine.lengths))

    def torque_residuals(self, motors: Array, rows: Array) -> Array:
        """Residuals of torques minus gravity torques, relative to the variation of the torques. Only slow samples count."""
        assert self.torques is not None
        closes, theta, _ = self.postures(motors)
        found = np.full(motors.shape, np.nan)
        regular = closes & (np.abs(np.sin(theta[..., 2] - theta[..., 1])) > REGULAR)
        found[regular] = holding_torques(self.scene, theta[regular])
        spread = np.std(self.torques, axis=0)
        off = np.clip((found - self.torques[rows]) / spread, -3.0, 3.0)
        slow = self.rates[rows] <= np.quantile(self.rates, 0.3)
        return np.where(slow[:, None] | np.isnan(off), off, 0.0)

    # Kinds of evidence

    def reach(self) -> Evidence:
        """Evidence from the reach: the misfit is the share of samples for which the loop does not close with the zeros of the map."""
        shares = [self.beyond(each.angles(self.encoders)) for each in ASSIGNMENTS]
        untold = np.zeros(2), np.full(2, np.inf)
        return Evidence(
            "the reach of the machine",
            "of the samples",
            tuple(Fit(share, *untold) for share in shares),
            1 - CLOSES,
            UNLIKE,
        )

    def closure(
        self, name: str, unit: str, residuals: Residuals, floor: float = FLOOR, most: float = WORST
    ) -> Evidence:
        """Evidence that also finds zeros: on a grid, then by fits from the best grid points and from the zeros of the map."""
        fits = tuple(self._fit(assignment.angles(self.encoders), residuals) for assignment in ASSIGNMENTS)
        return Evidence(name, unit, fits, floor, most)

    def _fit(self, motors: Array, residuals: Residuals) -> Fit:
        few = np.linspace(0, len(motors) - 1, min(len(motors), SAMPLES)).astype(int)
        every = np.arange(len(motors))
        line = np.arange(COARSE) * TURN / COARSE
        grid = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
        coarse = residuals(self, motors[few] + grid[:, None, :], few)
        shut = np.asarray(np.isnan(coarse).any(axis=-1))
        cost = np.nanmean(np.where(shut[..., None], CLOSED_OFF, coarse) ** 2, axis=(-2, -1)) + shut.mean(axis=-1)

        def of(zeros: Array, loop: "_Loop" = self) -> Array:
            return np.asarray(np.nan_to_num(residuals(loop, (motors + zeros)[None], every)[0], nan=CLOSED_OFF).ravel())

        best = Fit(np.inf, np.zeros(2), np.full(2, np.inf))
        for start in (np.zeros(2), *grid[np.argsort(cost)[:STARTS]]):
            found = optimize.least_squares(of, start, loss="soft_l1", f_scale=0.05)
            if self.postures(motors + found.x)[0].mean() < CLOSES:
                continue
            misfit = float(np.sqrt(np.mean(of(found.x) ** 2)))
            # The zeros of the map are kept unless others are clearly better.
            if misfit < 0.99 * best.misfit:
                jacobian = np.asarray(found.jac)
                normal = jacobian.T @ jacobian
                sigma = np.full(2, np.inf)
                if np.linalg.cond(normal) < 1e12:
                    # Slightly wrong lengths shift the zeros far more than the misfit reveals.
                    lengths = [of(found.x, loop) - of(found.x) for loop in self.longer()]
                    moved = np.linalg.solve(normal, jacobian.T @ np.column_stack(lengths))
                    sigma = np.sqrt(misfit**2 * np.diag(np.linalg.inv(normal)) + np.sum(moved**2, axis=1))
                best = Fit(misfit, found.x - TURN * np.round(found.x / TURN), sigma)
        return best

    def commanded(self) -> Evidence:
        """Evidence from commands: the angles should follow them; the mean differences without the servos' deflections are the zeros."""
        assert self.commands is not None
        fits = []
        deflections = self.deflections()
        led = self.commands - np.nan_to_num(deflections)
        spread = np.std(self.commands, axis=0)
        for assignment in ASSIGNMENTS:
            apart = led - assignment.angles(self.encoders)
            about = np.angle(np.mean(np.exp(1j * apart), axis=0))
            off = _wrapped(apart - about)
            sigma = np.std(off, axis=0)
            fits.append(Fit(float(np.sqrt(np.mean((off / spread) ** 2))), about, sigma))
        left, right = (self._basis(i, float(mean)) for i, mean in enumerate(deflections.mean(axis=0), 1))
        return Evidence("commands", "of their variation", tuple(fits), 0.05, UNLIKE, (left, right))

    def _basis(self, i: int, deflection: float) -> str:
        """The assumption behind the zero of motor angle `i` from commands, with the servo's mean deflection, rad, or NaN; "" without deflection."""
        if abs(deflection) < DEFLECTED:
            return ""
        if np.isfinite(deflection):
            return (
                f"without the servo's mean deflection of {plain(1e3 * deflection, 2)} mrad under load (servo.kp[{i}])"
            )
        has_gain = self.scene["servo.enabled"] and float(self.scene[f"servo.kp[{i}]"]) > 0
        why = (
            "the commands are out of reach or near direct singularities"
            if has_gain
            else "the scene has no gain (servo.enabled, servo.kp)"
        )
        return f"and the drive's deflection under load is part of it, since {why}"

    def deflections(self) -> Array:
        """Commands minus angles, rad, (n, 2), of the scene's servos at rest under weight, springs and recorded torques; NaN without servos or gains.

        Near direct singularities and beyond the reach it is the mean of the other samples.
        """
        assert self.commands is not None
        closes, theta, _ = self.postures(self.commands)
        regular = closes & (np.abs(np.sin(theta[..., 2] - theta[..., 1])) > REGULAR)
        gains = np.array([float(self.scene[f"servo.kp[{i}]"]) for i in (1, 2)])
        if not self.scene["servo.enabled"] or not regular.any():
            return np.full(self.commands.shape, np.nan)
        torques = np.full(self.commands.shape, np.nan)
        torques[regular] = holding_torques(self.scene, theta[regular])
        if self.torques is not None:
            torques = torques - self.torques
        torques = np.where(np.isnan(torques), np.nanmean(torques, axis=0), torques)
        return np.where(gains > 0, torques / np.where(gains > 0, gains, 1.0), np.nan)

    def legs(self, assignment: Assignment, zeros: Array) -> tuple[Passive, Passive]:
        """Column, sign and zero of each distal link."""
        assert self.passive is not None
        _, theta, _ = self.postures(assignment.angles(self.encoders) + zeros)
        straight, crossed = (float(np.nanmean(each**2)) for each in self._legs(theta[None], np.arange(len(theta))))
        legs = []
        for leg, column in enumerate((1, 0) if crossed < 0.99 * straight else (0, 1)):
            model = theta[:, 1 + leg] - (theta[:, 3 * leg] if self.relative[column] else 0.0)
            apart = {sign: model - sign * self.passive[:, column] for sign in (1, -1)}
            sign = min(apart, key=lambda sign: float(np.nanmean(_wrapped_about_mean(apart[sign]) ** 2)))
            legs.append(Passive(column, sign, float(np.angle(np.nanmean(np.exp(1j * apart[sign]))))))
        return legs[0], legs[1]


def _wrapped(angle: Array) -> Array:
    """Wraps angles to [-pi, pi], rad."""
    return np.asarray(angle - TURN * np.round(angle / TURN))


def _wrapped_about_mean(angle: Array) -> Array:
    """Angles (..., n) minus their circular mean, rad."""
    with np.errstate(invalid="ignore"):
        turned = np.exp(1j * angle)
        known = np.isfinite(turned)
        mean = np.angle(np.sum(np.where(known, turned, 0.0), axis=-1, keepdims=True))
        return _wrapped(angle - mean)
