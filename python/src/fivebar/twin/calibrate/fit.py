"""Least squares on whole trajectories: unknowns of the machine, and where each series of samples begins.

A long motion forgives no wrong start, so the fit begins with short pieces, each with a start of its own, and joins them level by
level. Derivatives are central differences of runs; a step moves the trajectory by `MOVED` at most, so that its error of truncation is
some 1e-5 of the derivative and that of the runs 1e-7. In the end they are taken with one, two and four times the step as well and
extrapolated to the step 0, and the same from twice the steps says what they can be trusted with (`Fit.doubt`).
"""

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from fivebar.twin.calibrate.data import Data, Samples
from fivebar.twin.calibrate.motion import LOST, Between, Machine, Path, Start
from fivebar.twin.calibrate.parameters import DELAY
from fivebar.twin.errors import TwinError
from fivebar.twin.recording import Array

MOVED: Final = 1e-3
"""rad: by how much the step of a derivative may move a trajectory."""

TIGHT: Final = 1e-11
"""rad: error per step of the runs that count, below the effect of unknowns on them by orders of magnitude, so that differences can be taken."""

LOOSE: Final = 1e-8
"""rad: of the runs on the way there."""

STILL: Final = 1e-4
"""rad: trajectories that moved by less have the derivatives that they had, as far as a fit needs them."""

IN_SIGHT: Final = 0.1
"""rad: residuals of a longer piece with which it takes the place of its shorter ones."""

LEVELS: Final = (0.1, 0.5, 2.0)
"""s: pieces of the first fits; those of the last are whole series, or `longest`. In 0.1 s a motion on springs that throw links about forgives
the start that is guessed."""

FEWEST: Final = 20
"""Samples of the shortest pieces."""

UNSOUND: Final = 30.0
"""Ratio of a piece's residuals to those of the median piece, above which its start counts as not found."""

ALL_NOISE: Final = 20.0
"""Ratio of residuals to `Fitter.noise`, a tenth of the encoder's, below which pieces show nothing else: the machine is as the fit has it."""

LOSES: Final = 3.0
"""Ratio of the residuals of longer pieces to those above which the fit has lost a chaotic motion: on two seconds of `spring_payload` residuals
are 0.04 mrad, on ten 4 mrad."""

BELIEVED: Final = 1.0
"""Standard deviation, in sizes of each unknown, of the prior in the first fit, before it is known which unknowns the record identifies."""

WEAK: Final = 10.0
"""Standard deviation of the prior, in sizes of each unknown, in later fits: too wide to move an estimate."""

OUTLIER: Final = 5.0
"""Standard deviations of leaps beyond which a sample is left out; in the end twice as many of residuals do as well."""

FEW: Final = 0.05
"""Share of the samples that may count as outliers."""

DEEPEST: Final = 0.1
"""s: the longest delay that is sought; samples as long after a start are not compared while it is."""

Show = Callable[[str], None]


class GivenUp(TwinError):
    """The fit has come to no end."""


@dataclass
class Piece:
    """A part of a series with a start of its own."""

    path: Path
    start: Start
    mask: Array
    """(n, 2): which angles are compared."""


@dataclass
class Fit:
    """Result of a fit. `jacobian` is of the encoders' angles, rad per unknown, for rows that are compared; columns are unknowns, then starts."""

    machine: Machine
    pieces: list[Piece]
    x: Array
    sigma: Array
    """(2): standard deviation of each encoder's residuals, rad."""

    residuals: list[Array]
    """(n, 2) of each piece, rad, NaN where nothing was measured."""

    jacobian: Array
    doubt: Array
    """An estimate of the error of `jacobian`."""

    rows: Array
    """Of each row: number of piece, of sample, of encoder."""

    outliers: int
    evaluations: int
    rms_before: float
    """Of the residuals for the scene as it was, rad, short pieces with fitted starts."""


class Fitter:
    """Runs the levels."""

    def __init__(
        self, machine: Machine, data: Data, between: Between, longest: float, show: Show, patience: float = math.inf
    ):
        self.machine, self.data, self.between, self.longest, self.show = machine, data, between, longest, show
        self.period = data.period
        self.sought = machine.sought
        self.steps: dict[int, float] = {}
        self.evaluations = 0
        self.patience, self.ends = patience, time.process_time() + patience
        self.noise = least_noise(data)
        self.known: tuple[tuple[int, bool], Array, list[Array]] | None = None
        """Derivatives that have been computed: of which fit, at which point, and their values."""
        self.delayed = any(p.name == DELAY for p in self.sought)

    # --- pieces -----------------------------------------------------------------------------------------------------------------

    def cut(self, length: float) -> list[Samples]:
        """Pieces of about that length, s; longer ones begin where shorter ones do."""
        found = []
        for series in self.data.series:
            span, count = series.time[-1] - series.time[0], 1
            for level in (self.longest, *reversed(LEVELS)):
                if level >= length:
                    count *= max(1, math.ceil(span / count / max(level, FEWEST * self.period) - 0.2))
            edges = np.searchsorted(
                series.time, series.time[0] + span * np.arange(1, count) / count - 0.5 * self.period
            )
            for a, b in zip([0, *edges], [*edges, len(series)], strict=True):
                # Pieces share a sample, but compare it once.
                part = series.part(a, min(b + 1, len(series)))
                if np.isfinite(part.angles).any(axis=1).sum() >= 6:
                    found.append(part)
        return found

    def piece(self, samples: Samples, start: Start) -> Piece:
        """A part of a series with that start."""
        return Piece(Path(samples, self.between, self.machine.library, self.period), start, self.compared(samples))

    def first(self, x: Array, length: float) -> list[Piece]:
        """Short pieces, on the side that fits; their starts are guessed from their first samples, then fitted to all."""
        pieces: list[Piece] = []
        side = int(self.machine.scene.get("init.assembly", 1))
        for samples in self.cut(length):
            state = guess(samples)
            costs = {}
            for assembly in (side, 3 - side):
                piece = self.piece(samples, Start(state, assembly))
                motion, end = self.machine.run(piece.path, x, piece.start)
                gap = samples.angles - self.machine.seen(piece.path, motion, x)
                costs[assembly] = float(np.nanmedian(np.abs(wrapped(gap)))) if motion[-1, 0] < LOST else math.inf, end
            assembly = side if costs[side][0] <= 2 * costs[3 - side][0] else 3 - side
            # Stretched or folded links, where errors of the angles count most, may refuse a start: other pieces are enough.
            if math.isfinite(costs[assembly][0]):
                side = costs[assembly][1]
                pieces.append(self.begun(self.piece(samples, Start(state, assembly)), x))
        if not pieces:
            raise TwinError(f"the unit refuses a start at the measured angles: {self.machine.failure}")
        return pieces

    def begun(self, piece: Piece, x: Array) -> Piece:
        """The piece with the start that fits best, the unknowns being as they are."""

        def residuals(state: Array) -> Array:
            return np.asarray(self.gap(piece, x, state)[piece.mask])

        result = least_squares(residuals, piece.start.state, x_scale=(1.0, 1.0, 100.0, 100.0), ftol=1e-3, max_nfev=15)
        return Piece(piece.path, Start(result.x, piece.start.assembly), piece.mask)

    def off(self, piece: Piece, x: Array) -> float:
        """Residual that nine of ten samples of a piece stay below, rad."""
        return float(np.quantile(np.abs(self.gap(piece, x, piece.start.state)[piece.mask]), 0.9))

    def sound(self, pieces: list[Piece], x: Array) -> list[Piece]:
        """Pieces whose starts were found: others, as at a singularity, would outweigh all."""
        off = np.array([self.off(piece, x) for piece in pieces])
        return [
            piece for piece, residual in zip(pieces, off, strict=True) if residual <= UNSOUND * float(np.median(off))
        ]

    def joined(self, pieces: list[Piece], x: Array, length: float) -> list[Piece]:
        """Longer pieces, which begin where the motion of the shorter ones is then; shorter ones stay where it is lost over the longer one."""
        found = []
        for samples in self.cut(length):
            begin, end = samples.time[0], samples.time[-1]
            shorter = [piece for piece in pieces if begin <= piece.path.samples.time[0] < end]
            found += shorter
            if shorter and shorter[0].path.samples.time[0] == begin:
                longer = self.piece(samples, shorter[0].start)
                if self.off(longer, x) < IN_SIGHT:
                    found[len(found) - len(shorter) :] = [longer]
        return found

    def compared(self, samples: Samples) -> Array:
        """Mask of the angles that are compared: all finite ones but the last of a piece with which another piece begins."""
        mask: Array = np.isfinite(samples.angles)
        ends = {series.time[-1] for series in self.data.series}
        if samples.time[-1] not in ends:
            mask[-1] = False
        if self.delayed:
            mask &= (samples.time - samples.time[0] >= DEEPEST)[:, None]
        return mask

    # --- residuals and derivatives ----------------------------------------------------------------------------------------------

    def motion(self, piece: Piece, x: Array, state: Array) -> Array:
        """Angles that the encoders would show over a piece, rad, (n, 2)."""
        if time.process_time() > self.ends:
            raise GivenUp(
                f"the fit has come to no end within {self.patience:g} s of CPU (--patience): the scene is probably not this machine; "
                "are its geometry, the encoders' places, signs and zeros, and what the drives are told right?"
            )
        motion, _ = self.machine.run(piece.path, x, Start(state, piece.start.assembly))
        return self.machine.seen(piece.path, motion, x)

    def gaps(self, pieces: list[Piece], z: Array) -> list[Array]:
        """Measured minus computed, (n, 2) of each piece."""
        p = len(self.sought)
        return [self.gap(piece, z[:p], z[p + 4 * number : p + 4 * number + 4]) for number, piece in enumerate(pieces)]

    def gap(self, piece: Piece, x: Array, state: Array) -> Array:
        """Measured minus computed of one piece, (n, 2); half a turn where the run could not go on, so that no such run is the better one."""
        gap = piece.path.samples.angles - self.motion(piece, x, state)
        return np.where(np.abs(gap) < 0.5 * LOST, wrapped(gap), np.pi * np.sign(gap))

    def derivatives(self, pieces: list[Piece], z: Array, times: float = 1.0, central: bool = True) -> list[Array]:
        """d(angles of the encoders)/dz of each piece, (n, 2, p + 4): columns are unknowns, then the start of the piece."""
        p = len(self.sought)
        self.evaluations += (2 if central else 1) * (p + 4)
        found = []
        for number, piece in enumerate(pieces):
            state = z[p + 4 * number : p + 4 * number + 4]
            here = None if central else self.motion(piece, z[:p], state)
            columns = []
            for j in range(p + 4):
                step = times * self.step(j)
                near = []
                for sign in (1.0, -1.0) if central else (1.0,):
                    x, s = z[:p].copy(), state.copy()
                    if j < p:
                        # At the bound of an unknown just inside of it, for the unit refuses values outside.
                        x[j] = max(x[j], self.sought[j].lowest + 4.01 * self.step(j)) + sign * step
                    else:
                        s[j - p] += sign * step
                    near.append(self.motion(piece, x, s))
                slope = (near[0] - near[1]) / (2 * step) if here is None else (near[0] - here) / step
                columns.append(np.clip(slope, -1e9, 1e9))
            found.append(np.stack(columns, axis=2))
        if times == 1.0:
            self._learn(found)
        return found

    def recent(self, pieces: list[Piece], z: Array, final: bool) -> list[Array]:
        """Derivatives; those that there are if they were taken so near that trajectories have hardly moved since."""
        p = len(self.sought)
        if self.known is not None and self.known[0] == (len(pieces), final):
            moves = z - self.known[1]
            parts = [
                d @ np.concatenate([moves[:p], moves[p + 4 * k : p + 4 * k + 4]]) for k, d in enumerate(self.known[2])
            ]
            if max(float(np.max(np.abs(part))) for part in parts) < STILL * (1 if final else 10):
                return self.known[2]
        found = self.derivatives(pieces, z, central=final)
        self.known = (len(pieces), final), z.copy(), found
        return found

    def step(self, j: int) -> float:
        """Of the j-th column: 1e-4 of the unknown's size, rad or rad/s until more is known."""
        return self.steps.get(j, 1e-4)

    def _learn(self, derivatives: list[Array]) -> None:
        """Steps that move trajectories by `MOVED`."""
        largest = np.max([np.max(np.abs(d), axis=(0, 1)) for d in derivatives], axis=0)
        for j, slope in enumerate(largest.tolist()):
            self.steps[j] = min(max(MOVED / max(slope, 1e-12), 1e-8), 1e-2)

    # --- least squares ----------------------------------------------------------------------------------------------------------

    def solve(self, pieces: list[Piece], z: Array, sigma: Array, final: bool, prior: Array) -> Array:
        """One fit; before the final one derivatives are taken on one side. `prior`: rows of deviations from the scene, in standard deviations."""
        p = len(self.sought)
        origin = np.array([parameter.origin for parameter in self.sought])
        lowest = np.concatenate([[parameter.lowest for parameter in self.sought], np.full(len(z) - p, -np.inf)])
        z = np.maximum(z, lowest + 1e-9)

        def residuals(z: Array) -> Array:
            self.evaluations += 1
            rows = [(gap / sigma)[piece.mask] for piece, gap in zip(pieces, self.gaps(pieces, z), strict=True)]
            return np.concatenate([*rows, prior @ (z[:p] - origin)])

        def jacobian(z: Array) -> Array:
            blocks = [
                -(d / sigma[:, None])[piece.mask]
                for piece, d in zip(pieces, self.recent(pieces, z, final), strict=True)
            ]
            full = np.zeros((sum(map(len, blocks)) + len(prior), len(z)))
            row = 0
            for number, block in enumerate(blocks):
                full[row : row + len(block), :p] = block[:, :p]
                full[row : row + len(block), p + 4 * number : p + 4 * number + 4] = block[:, p:]
                row += len(block)
            full[row:, :p] = prior
            return full

        result = least_squares(
            residuals, z, jac=jacobian, bounds=(lowest, np.inf), method="trf", x_scale="jac", xtol=1e-10, gtol=1e-12,
            ftol=1e-6 if final else 0.1, max_nfev=20 if final else 10,
        )  # fmt: skip
        return np.asarray(result.x)

    def run(self) -> Fit:
        """The first fit, from the scene on: it is not known yet which unknowns the record identifies."""
        return self._run(np.array([p.start for p in self.sought]), np.eye(len(self.sought)) / BELIEVED)

    def again(self, pinned: Array, held: Array) -> Fit:
        """A later fit, from the scene on.

        Combinations of unknowns, the rows of `pinned`, stay what they are in the scene; unknowns stay near to it with standard deviations
        `held`, in sizes.
        """
        origin = np.array([parameter.origin for parameter in self.sought])
        x = np.array([parameter.start for parameter in self.sought])
        x -= np.linalg.pinv(pinned) @ pinned @ (x - origin)
        x = np.maximum(x, [parameter.lowest for parameter in self.sought])
        return self._run(x, np.vstack([np.diag(1 / np.minimum(held, WEAK)), 1e4 * pinned]))

    def _run(self, x: Array, prior: Array) -> Fit:
        """All levels."""
        pieces, z, rms_before = self.levels(x, prior)
        z, outliers = self.settle(pieces, z, True, prior)
        return self.finish(pieces, z, outliers, rms_before)

    def settle(self, pieces: list[Piece], z: Array, final: bool, prior: Array) -> tuple[Array, int]:
        """Fits until residuals and outliers stay as they are; returns the number of outliers."""
        before, left_out = np.full(2, np.inf), -1
        for _ in range(8):
            gaps = self.gaps(pieces, z)
            sigma = np.maximum(spread(gaps, pieces), self.noise)
            outliers = self.leave_out(pieces, gaps, sigma if final else np.full(2, np.inf))
            if outliers == left_out if final else bool(np.all(sigma > 0.8 * before)):
                break
            before, left_out = sigma, outliers
            z = self.solve(pieces, z, sigma, final, prior)
        return z, max(left_out, 0)

    def levels(self, x: Array, prior: Array) -> tuple[list[Piece], Array, float]:
        """From short pieces to whole series: pieces, their fit, and the residuals of the scene as it was, rad."""
        p = len(self.sought)
        self.machine.tolerance(LOOSE)
        lengths = [length for length in LEVELS if length < min(self.span(), self.longest)] + [self.longest]
        if self.delayed:
            # Of shorter pieces hardly a sample would be compared.
            lengths = [length for length in lengths if length > 2 * DEEPEST]
        pieces = self.first(x, lengths[0])
        z, left, before = pack(x, pieces), np.full(2, np.inf), 0.0
        for length in lengths:
            longer = self.sound(self.joined(pieces, x, length), x)
            begin = pack(x, longer)
            sigma = np.maximum(spread(self.gaps(longer, begin), longer), self.noise)
            # The shortest pieces show little, for each has a start of its own.
            before = before if length > max(lengths[:2]) else float(np.mean(sigma))
            self.show(
                f"pieces of {min(length, self.span()):g} s: residuals of {1e3 * float(np.mean(sigma)):.3g} mrad before the fit"
            )
            end, _ = self.settle(longer, begin, False, prior)
            found = spread(self.gaps(longer, end), longer)
            if np.all(left < ALL_NOISE * self.noise) and np.any(found > LOSES * left):
                self.show("the motion is chaotic over pieces as long: shorter ones stay")
                break
            x, z, pieces = end[:p], end, unpack(end, longer, p)
            # The shortest pieces, with a start each, show hardly more than noise whatever the machine is.
            left = np.maximum(found, self.noise) if length > lengths[0] else left
        self.machine.tolerance(TIGHT)
        return pieces, z, before

    def finish(self, pieces: list[Piece], z: Array, outliers: int, rms_before: float) -> Fit:
        """Residuals, derivatives and their doubt at the solution."""
        p = len(self.sought)
        gaps = self.gaps(pieces, z)
        # All three here: those with which the fit came here would count as errors of derivatives.
        one, two, four = (self.derivatives(pieces, z, times) for times in (1.0, 2.0, 4.0))
        size = sum(int(piece.mask.sum()) for piece in pieces)
        jacobian, doubt = np.zeros((size, len(z))), np.zeros((size, len(z)))
        rows = np.zeros((size, 3), dtype=int)
        row = 0
        squares, counts = np.zeros(2), np.zeros(2)
        for number, piece in enumerate(pieces):
            inside = slice(row, row + int(piece.mask.sum()))
            # Extrapolated to the step 0 (Richardson); the same from twice the steps says how far that can be trusted.
            best, other = (4 * one[number] - two[number]) / 3, (4 * two[number] - four[number]) / 3
            for target, blocks in ((jacobian, best), (doubt, best - other)):
                target[inside, :p] = blocks[piece.mask][:, :p]
                target[inside, p + 4 * number : p + 4 * number + 4] = blocks[piece.mask][:, p:]
            rows[inside] = np.column_stack([np.full(inside.stop - row, number), *np.nonzero(piece.mask)])
            row = inside.stop
            squares += np.sum(np.where(piece.mask, gaps[number], 0.0) ** 2, axis=0)
            counts += piece.mask.sum(axis=0)
        free = max(1 - len(z) / max(size, 1), 0.05)
        sigma = np.sqrt(squares / np.maximum(counts, 1) / free)
        fitted = unpack(z, pieces, p)
        return Fit(
            self.machine,
            fitted,
            z[:p],
            np.maximum(sigma, 1e-12),
            gaps,
            jacobian,
            doubt,
            rows,
            outliers,
            self.evaluations,
            rms_before,
        )

    def leave_out(self, pieces: list[Piece], gaps: list[Array], sigma: Array) -> int:
        """Outliers are not compared; how many there are: residuals that leap from those around them, and such as are far off at all.

        What a fit has not reached yet changes smoothly, and is no outlier.
        """
        leaps = [np.abs(gap - around(gap)) for gap in gaps]
        usual = np.maximum(spread(leaps, pieces), self.noise)
        usable = [self.compared(piece.path.samples) for piece in pieces]
        # A leap among leaps is the fit's fault, not a sample's.
        alone = [leap / np.maximum(usual, np.nan_to_num(around(leap, 10))) for leap in leaps]
        leapt = beyond(usable, alone, np.full(2, OUTLIER))
        # Large residuals mark outliers once the residuals are near the noise that third differences of the samples show.
        reached = bool(np.all(sigma < 50 * self.noise))
        far = beyond(usable, [np.abs(gap) for gap in gaps], 2 * OUTLIER * sigma if reached else np.full(2, np.inf))
        for piece, mask, *out in zip(pieces, usable, leapt, far, strict=True):
            piece.mask = mask & ~out[0] & ~out[1]
        return sum(int(mask.sum() - piece.mask.sum()) for mask, piece in zip(usable, pieces, strict=True))

    def span(self) -> float:
        """s of the longest series."""
        return max(float(series.time[-1] - series.time[0]) for series in self.data.series)


def least_noise(data: Data) -> Array:
    """The least standard deviation to believe in, rad: a tenth of the noise that third differences of each encoder show, and not 0."""
    found = []
    for i in (0, 1):
        thirds = np.concatenate([np.diff(s.angles[:, i], 3) for s in data.series])
        thirds = thirds[np.isfinite(thirds)]
        found.append(0.1 * 1.4826 * float(np.median(np.abs(thirds))) / math.sqrt(20) if len(thirds) else 0.0)
    return np.maximum(found, 1e-9)


def beyond(usable: list[Array], sizes: list[Array], limits: Array) -> list[Array]:
    """Masks of the samples beyond their encoder's limit: the furthest ones only, if these are more than `FEW` of all.

    Where many are, the fit is not there yet, or the machine is another one.
    """
    ratios = [np.where(mask, np.nan_to_num(size) / limits, 0.0) for mask, size in zip(usable, sizes, strict=True)]
    every = np.concatenate([ratio[mask] for ratio, mask in zip(ratios, usable, strict=True)])
    limit = max(1.0, float(np.quantile(every, 1 - FEW))) if len(every) else 1.0
    return [ratio > limit for ratio in ratios]


def around(gap: Array, reach: int = 4) -> Array:
    """Of each residual the median of those around it, (n, 2)."""
    padded = np.pad(gap, ((reach, reach), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0)
    with warnings.catch_warnings():
        # A window without a sample has no median.
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmedian(windows, axis=2))


def guess(samples: Samples) -> Array:
    """Angles and rates at the first sample, by parabolas through the first ones, outliers left out."""
    state = np.zeros(4)
    for i in (0, 1):
        known = np.flatnonzero(np.isfinite(samples.angles[:, i]))[:9]
        if len(known) < 3:
            raise TwinError(
                f"a series has {len(known)} angles of encoder {i + 1}; both encoders are needed to begin with"
            )
        time, angle = samples.time[known] - samples.time[0], np.unwrap(samples.angles[known, i])
        while True:
            fitted = np.polynomial.polynomial.polyfit(time, angle, min(2, len(time) - 1))
            off = np.abs(angle - np.polynomial.polynomial.polyval(time, fitted))
            # One that is far off at a time, as long as enough are left.
            if len(time) < 6 or off.max() < 4 * np.median(off) or off.max() < 1e-6:
                break
            time, angle = np.delete(time, off.argmax()), np.delete(angle, off.argmax())
        state[i], state[2 + i] = fitted[0], fitted[1]
    return state


def pack(x: Array, pieces: list[Piece]) -> Array:
    """Unknowns and starts as one vector."""
    return np.concatenate([x, *(piece.start.state for piece in pieces)])


def unpack(z: Array, pieces: list[Piece], p: int) -> list[Piece]:
    """The pieces with the starts of a vector."""
    return [
        Piece(piece.path, Start(z[p + 4 * k : p + 4 * k + 4], piece.start.assembly), piece.mask)
        for k, piece in enumerate(pieces)
    ]


def spread(gaps: list[Array], pieces: list[Piece]) -> Array:
    """Standard deviations of both encoders' residuals, rad, as their medians say."""
    found = []
    for i in (0, 1):
        values = np.concatenate([np.abs(gap[:, i][piece.mask[:, i]]) for gap, piece in zip(gaps, pieces, strict=True)])
        found.append(1.4826 * float(np.median(values)) if len(values) else 0.0)
    return np.array(found)


def wrapped(angle: Array) -> Array:
    """Angle less its whole turns, rad, within half a turn of 0."""
    return angle - 2 * math.pi * np.round(angle / (2 * math.pi))
