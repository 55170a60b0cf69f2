"""Least squares on whole trajectories: fits unknowns of the machine and the start state of each series.

A fit of a long motion does not converge from a wrong start. It therefore begins with short pieces, each with its own start, and joins them
level by level. Derivatives are central differences of runs. A step moves the trajectory by at most `MOVED`, so that the relative truncation
error is about 1e-5 and the relative error due to the runs is 1e-7. Final derivatives use one, two and four times the step and are
extrapolated to step 0. The same extrapolation from twice the steps gives their error (`Fit.doubt`).
"""

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from fivebar.plain import plain
from fivebar.twin.calibrate import assumptions
from fivebar.twin.calibrate.data import Data, Samples
from fivebar.twin.calibrate.motion import LOST, Between, Machine, Path, Start
from fivebar.twin.calibrate.parameters import COMMANDS, DELAY
from fivebar.twin.errors import TwinError
from fivebar.twin.recording import Array

MOVED: Final = 1e-3
"""Maximum change of a trajectory by the step of a derivative, rad."""

TIGHT: Final = 1e-11
"""Error tolerance per step of the final runs, rad: orders of magnitude below the effect of the unknowns, to allow finite differences."""

LOOSE: Final = 1e-8
"""Error tolerance per step of earlier runs, rad."""

SHORT: Final = 0.01
"""Step of a one-sided difference in units of `MOVED`, for runs at `TIGHT`: truncation of 1e-5 and errors of the runs of 1e-6 of the derivative."""

STILL: Final = 1e-4
"""Maximum change of trajectories, rad, for which a fit reuses earlier derivatives."""

IN_SIGHT: Final = 0.1
"""Maximum residual, rad, at which a longer piece replaces its shorter ones."""

LEVELS: Final = (0.1, 0.5, 2.0)
"""Lengths of the pieces in the first fits, s; the last fit uses whole series, or `longest`. Over 0.1 s, even a fast motion on springs converges
from the guessed start."""

MANY: Final = 20
"""If there are at least this many pieces of the second length, only shortest pieces that start one of them are fitted: these suffice to begin with."""

FEWEST: Final = 20
"""Minimum number of samples in a piece."""

ALIKE: Final = 1e-3
"""Median residual, rad, below which an assembly fits, however well the other one does."""

UNSOUND: Final = 30.0
"""Ratio of a piece's residuals to the median over all pieces, above which the start of the piece counts as not found."""

VISIBLE: Final = 3e-4
"""Residuals of the shortest pieces, rad, from which other assumptions are tried; below, effects that are not fitted explain the residuals as well."""

ALL_NOISE: Final = 20.0
"""Ratio of residuals to `Fitter.noise` (a tenth of the encoder's noise), below which residuals are only noise: the fitted machine is right."""

LOSES: Final = 3.0
"""Ratio of the residuals of longer pieces to residuals of shorter ones, above which the fit has lost a chaotic motion; of a short piece to the
median one, above which its assembly may be wrong. On `spring_payload`, residuals
are 0.04 mrad over 2 s and 4 mrad over 10 s."""

LIMIT: Final = 0.5
"""Standard deviation, in sizes of an unknown, from which it counts as not identified: half of the scene's value."""

BELIEVED: Final = 1.0
"""Prior standard deviation in sizes of each unknown for the first fit, before it is known which unknowns the record identifies."""

WEAK: Final = 10.0
"""Prior standard deviation in sizes of each unknown for later fits: too wide to change an estimate."""

OUTLIER: Final = 5.0
"""Limit for jumps of residuals, in standard deviations; samples beyond it are outliers. The final fit also excludes residuals beyond twice as many."""

FEW: Final = 0.05
"""Maximum share of outliers."""

DEEPEST: Final = 0.1
"""Longest fitted delay, s. If the delay of encoders is fitted, samples within this time after a start are not compared; if commands act late, within
this time after the beginning of a series."""

PINNED: Final = 1e4
"""Weight of a combination of unknowns that keeps its value."""

Show = Callable[[str], None]


STAGES: Final = (
    ("delay", (DELAY, COMMANDS)),
    ("gravity", ("gravity.",)),
    ("drives and friction", ("servo.", "torque.", "viscous.", "friction.")),
    ("masses and geometry", ("",)),
)
"""Order in which unknowns are fitted to the shortest pieces, by the beginnings of their names; each stage keeps the unknowns of earlier ones."""

EXPLAINS: Final = 0.9
"""Ratio of residuals after and before a stage, above which its values are dropped: they may only compensate for unknowns of a later stage."""


@dataclass(frozen=True)
class Stage:
    """Residuals before and after a stage of the fit."""

    name: str
    seconds: float
    """Length of the pieces, s."""

    before: float
    """rms of the residuals in the median piece with the values of the stages before, rad."""

    after: float

    def sentence(self) -> str:
        """The stage in words."""
        return f"{self.name}, pieces of {self.seconds:g} s: residuals of {plain(1e3 * self.before)} mrad become {plain(1e3 * self.after)} mrad"


class TimeLimitExceeded(TwinError):
    """The fit has exceeded its time limit."""


@dataclass
class Piece:
    """A part of a series with its own start."""

    path: Path
    start: Start
    mask: Array
    """(n, 2): whether each angle is compared."""


@dataclass
class Fit:
    """Result of a fit. `jacobian` contains derivatives of encoder angles, rad per unknown, for compared rows; its columns are unknowns, then starts."""

    machine: Machine
    pieces: list[Piece]
    x: Array
    sigma: Array
    """(2): standard deviation of each encoder's residuals, rad."""

    residuals: list[Array]
    """(n, 2) for each piece, rad; NaN without a measurement."""

    jacobian: Array
    doubt: Array
    """Estimated error of `jacobian`."""

    rows: Array
    """Index of piece, sample and encoder for each row."""

    outliers: int
    evaluations: int
    rms_before: float
    """rms of the residuals with the values of the scene, rad, for short pieces with fitted starts."""

    stages: list[Stage]


class Fitter:
    """Runs the fits, from short to long pieces."""

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
        self.known: tuple[tuple[list[int], bool, bytes], Array, list[Array]] | None = None
        """Last computed derivatives: key of the fit, point and values."""
        self.finished: tuple[Array, list[list[Array]]] | None = None
        """Derivatives of the last finished fit, with one, two and four times the step: point and values."""
        self.free = np.ones(len(machine.sought), dtype=bool)
        """Unknowns that are fitted now; the others keep their values."""
        self.stages: list[Stage] = []
        self.delayed = any(p.name == DELAY for p in self.sought)
        self.late = any(p.name == COMMANDS for p in self.sought) or float(machine.scene.get(COMMANDS, 0.0)) > 0.0
        """Whether commands act late: then commands from before a series act on its first samples, and are unknown."""

    # --- pieces -----------------------------------------------------------------------------------------------------------------

    def cut(self, length: float) -> list[Samples]:
        """Cuts the series into pieces of about `length` s; each longer piece starts at the start of a shorter one."""
        found = []
        for series in self.data.series:
            if self.late:
                series = series.part(int(np.searchsorted(series.time, series.time[0] + DEEPEST)), len(series))
            if not len(series):
                continue
            period = series.period or self.period
            span, count = series.time[-1] - series.time[0], 1
            for level in (self.longest, *reversed(LEVELS)):
                if level >= length:
                    count *= max(1, math.ceil(span / count / max(level, FEWEST * period) - 0.2))
            edges = np.searchsorted(series.time, series.time[0] + span * np.arange(1, count) / count - 0.5 * period)
            for a, b in zip([0, *edges], [*edges, len(series)], strict=True):
                # Neighbouring pieces share a sample, which is compared once.
                part = series.part(a, min(b + 1, len(series)))
                if np.isfinite(part.angles).any(axis=1).sum() >= 6:
                    found.append(part)
        return found

    def piece(self, samples: Samples, start: Start) -> Piece:
        """A piece with the given start."""
        path = Path(samples, self.between, self.machine.library, samples.period or self.period)
        return Piece(path, start, self.compared(samples))

    def first(self, x: Array, lengths: list[float]) -> list[Piece]:
        """Pieces of the first length, with the assembly that fits. Their starts are guessed from their first samples, then fitted to all samples.

        If there are many pieces of the second length, only pieces that start one of these are used.
        """
        pieces: list[Piece] = []
        begins = [samples.time[0] for samples in self.cut(lengths[min(1, len(lengths) - 1)])]
        side = int(self.machine.scene.get("init.assembly", 1))
        for samples in self.cut(lengths[0]):
            if len(begins) >= MANY and samples.time[0] not in begins:
                continue
            state = guess(samples)
            costs = {}
            for assembly in (side, 3 - side):
                piece = self.piece(samples, Start(state, assembly))
                motion, end = self.machine.run(piece.path, x, piece.start)
                gap = samples.angles - self.machine.seen(piece.path, motion, x)
                costs[assembly] = float(np.nanmedian(np.abs(wrapped(gap)))) if motion[-1, 0] < LOST else math.inf, end
            # At rest both assemblies fit, and their residuals are noise.
            assembly = side if costs[side][0] <= max(2 * costs[3 - side][0], ALIKE) else 3 - side
            # A start may be refused near stretched or folded links, where angle errors matter most; the other pieces suffice.
            if math.isfinite(costs[assembly][0]):
                side = costs[assembly][1]
                pieces.append(self.begun(self.piece(samples, Start(state, assembly)), x))
        if not pieces:
            raise TwinError(f"the unit refuses a start at the measured angles: {self.machine.failure}")
        return pieces

    def begun(self, piece: Piece, x: Array) -> Piece:
        """The piece with the best start for fixed unknowns."""

        def residuals(state: Array) -> Array:
            return np.asarray(self.gap(piece, x, state)[piece.mask])

        result = least_squares(residuals, piece.start.state, x_scale=(1.0, 1.0, 100.0, 100.0), ftol=1e-3, max_nfev=15)
        return Piece(piece.path, Start(result.x, piece.start.assembly), piece.mask)

    def off(self, piece: Piece, x: Array) -> float:
        """90th percentile of a piece's residuals, rad."""
        return float(np.quantile(np.abs(self.gap(piece, x, piece.start.state)[piece.mask]), 0.9))

    def sound(self, pieces: list[Piece], x: Array) -> list[Piece]:
        """Pieces with a good start; the others, for example at a singularity, would dominate the fit."""
        off = np.array([self.off(piece, x) for piece in pieces])
        return [
            piece for piece, residual in zip(pieces, off, strict=True) if residual <= UNSOUND * float(np.median(off))
        ]

    def joined(self, pieces: list[Piece], x: Array, length: float) -> list[Piece]:
        """Longer pieces with the starts of the shorter ones; shorter pieces are kept if the motion is lost over the longer one."""
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
        """Mask of the compared angles: all finite ones, except the last sample of a piece if the next piece starts with it."""
        mask: Array = np.isfinite(samples.angles)
        ends = {series.time[-1] for series in self.data.series}
        if samples.time[-1] not in ends:
            mask[-1] = False
        if self.delayed:
            mask &= (samples.time - samples.time[0] >= DEEPEST)[:, None]
        return mask

    # --- residuals and derivatives ----------------------------------------------------------------------------------------------

    def motion(self, piece: Piece, x: Array, state: Array) -> Array:
        """Predicted encoder angles over a piece, rad, (n, 2)."""
        if time.process_time() > self.ends:
            raise TimeLimitExceeded(
                f"the fit did not converge within {self.patience:g} s of CPU (--patience): the scene is probably not this machine; "
                "are its geometry, the order, signs and zeros of the encoders, and the drive commands right?"
            )
        motion, _ = self.machine.run(piece.path, x, Start(state, piece.start.assembly))
        return self.machine.seen(piece.path, motion, x)

    def gaps(self, pieces: list[Piece], z: Array) -> list[Array]:
        """Measured minus computed angles, (n, 2) for each piece."""
        p = len(self.sought)
        return [self.gap(piece, z[:p], z[p + 4 * number : p + 4 * number + 4]) for number, piece in enumerate(pieces)]

    def gap(self, piece: Piece, x: Array, state: Array) -> Array:
        """Measured minus computed angles of one piece, (n, 2); half a turn after a failure, so that a failed run is never the better one."""
        gap = piece.path.samples.angles - self.motion(piece, x, state)
        return np.where(np.abs(gap) < 0.5 * LOST, wrapped(gap), np.pi * np.sign(gap))

    def derivatives(self, pieces: list[Piece], z: Array, times: float = 1.0, central: bool = True) -> list[Array]:
        """d(encoder angles)/dz of each piece, (n, 2, p + 4): unknowns, then the start of the piece.

        `times`: size of the step, 1 for one that moves trajectories by `MOVED`.
        """
        p = len(self.sought)
        self.evaluations += (2 if central else 1) * (int(self.free.sum()) + 4)
        found = []
        for number, piece in enumerate(pieces):
            state = z[p + 4 * number : p + 4 * number + 4]
            here = None if central else self.motion(piece, z[:p], state)
            columns = []
            for j in range(p + 4):
                step = times * self.step(j)
                near = []
                if j < p and not self.free[j]:
                    columns.append(np.zeros_like(piece.path.samples.angles))
                    continue
                for sign in (1.0, -1.0) if central else (1.0,):
                    x, s = z[:p].copy(), state.copy()
                    if j < p:
                        # At the bound of an unknown, the middle moves inside: the unit refuses values beyond the bound.
                        middle = max(x[j], self.sought[j].lowest + 4.01 * self.step(j)) if central else x[j]
                        x[j] = middle + sign * step
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
        """Derivatives; reuses the last ones if the trajectories have hardly moved since."""
        key = ([len(piece.path.samples) for piece in pieces], final, self.free.tobytes())
        still = STILL * (1 if final else 10)
        if self.known and self.known[0] == key and self.moved(self.known[2], z - self.known[1]) < still:
            return self.known[2]
        # One-sided steps need to be short, for which only the final runs are accurate enough.
        found = self.derivatives(pieces, z, SHORT if final else 1.0, central=False)
        self.known = key, z.copy(), found
        return found

    def moved(self, derivatives: list[Array], moves: Array) -> float:
        """Largest change of the trajectories, rad, to first order."""
        p = len(self.sought)
        parts = [d @ np.concatenate([moves[:p], moves[p + 4 * k : p + 4 * k + 4]]) for k, d in enumerate(derivatives)]
        return max(float(np.max(np.abs(part))) for part in parts)

    def step(self, j: int) -> float:
        """Step for column j; initially 1e-4 of the unknown's size, rad or rad/s."""
        return self.steps.get(j, 1e-4)

    def _learn(self, derivatives: list[Array]) -> None:
        """Chooses steps that move trajectories by `MOVED`."""
        largest = np.max([np.max(np.abs(d), axis=(0, 1)) for d in derivatives], axis=0)
        for j, slope in enumerate(largest.tolist()):
            if j < len(self.sought) and not self.free[j]:
                continue
            self.steps[j] = min(max(MOVED / max(slope, 1e-12), 1e-8), 1e-2)

    # --- least squares ----------------------------------------------------------------------------------------------------------

    def solve(self, pieces: list[Piece], z: Array, sigma: Array, final: bool, prior: Array) -> Array:
        """One fit. `prior`: rows of deviations from the scene, in standard deviations."""
        p = len(self.sought)
        origin = np.array([parameter.origin for parameter in self.sought])
        lowest = np.concatenate([[parameter.lowest for parameter in self.sought], np.full(len(z) - p, -np.inf)])
        z = np.maximum(z, lowest + 1e-9)
        fitted = np.concatenate([self.free, np.ones(len(z) - p, dtype=bool)])

        def whole(part: Array) -> Array:
            every = z.copy()
            every[fitted] = part
            return every

        def residuals(part: Array) -> Array:
            self.evaluations += 1
            z = whole(part)
            rows = [(gap / sigma)[piece.mask] for piece, gap in zip(pieces, self.gaps(pieces, z), strict=True)]
            return np.concatenate([*rows, prior @ (z[:p] - origin)])

        def jacobian(part: Array) -> Array:
            z = whole(part)
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
            return full[:, fitted]

        result = least_squares(
            residuals, z[fitted], jac=jacobian, bounds=(lowest[fitted], np.inf), method="trf", x_scale="jac", xtol=1e-10, gtol=1e-12,
            ftol=1e-6 if final else 0.1, max_nfev=20 if final else 10,
        )  # fmt: skip
        return whole(result.x)

    def run(self) -> Fit:
        """The first fit, from the values of the scene; it is not known yet which unknowns the record identifies."""
        return self._run(np.array([p.start for p in self.sought]), np.eye(len(self.sought)) / BELIEVED)

    def again(self, fit: Fit, pinned: Array, held: Array) -> Fit:
        """A later fit. It begins where the derivatives of `fit` expect its end, or with the values of the scene if the motion is lost there.

        The combinations of unknowns in the rows of `pinned` keep their values in the scene. Each unknown has a prior at its value in the scene
        with standard deviation `held`, in sizes.
        """
        p = len(self.sought)
        prior = np.vstack([np.diag(1 / np.minimum(held, WEAK)), PINNED * pinned])
        lowest = np.array([parameter.lowest for parameter in self.sought])
        z = expected(fit, prior, np.array([parameter.origin for parameter in self.sought]))
        z[:p] = np.maximum(z[:p], lowest)
        near = unpack(z, fit.pieces, p)
        if all(self.off(piece, z[:p]) < IN_SIGHT for piece in near):
            z, outliers = self.settle(near, z, True, prior)
            return self.finish(near, z, outliers, fit.rms_before)
        origin = np.array([parameter.origin for parameter in self.sought])
        x = np.array([parameter.start for parameter in self.sought])
        x -= np.linalg.pinv(pinned) @ pinned @ (x - origin)
        return self._run(np.maximum(x, lowest), prior)

    def _run(self, x: Array, prior: Array) -> Fit:
        """Runs all levels and the final fit."""
        pieces, z, rms_before = self.levels(x, prior)
        z, outliers = self.settle(pieces, z, True, prior)
        return self.finish(pieces, z, outliers, rms_before)

    def settle(self, pieces: list[Piece], z: Array, final: bool, prior: Array) -> tuple[Array, int]:
        """Repeats the fit until residuals and outliers no longer change; returns the solution and the number of outliers."""
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
        """Fits short pieces, then longer ones up to whole series; returns pieces, solution, and residuals with the scene's values, rad."""
        p = len(self.sought)
        self.machine.tolerance(LOOSE)
        lengths = [length for length in LEVELS if length < min(self.span(), self.longest)] + [self.longest]
        if self.delayed:
            # In shorter pieces, hardly any sample would be compared.
            lengths = [length for length in lengths if length > 2 * DEEPEST]
        pieces = self.first(x, lengths)
        z, left, before = pack(x, pieces), np.full(2, np.inf), 0.0
        self.stages = []
        for length in lengths:
            longer = self.sound(self.joined(pieces, x, length), x)
            begin = pack(x, longer)
            sigma = np.maximum(spread(self.gaps(longer, begin), longer), self.noise)
            # The shortest pieces reveal little of the machine, because each has its own start.
            before = before if length > max(lengths[:2]) else float(np.mean(sigma))
            if length == lengths[0]:
                longer, end = self.explain(longer, begin, prior, length)
            else:
                end = self.stage("all unknowns", longer, begin, prior, length)
                if length == lengths[1] and (identified := self.determined(longer, end)) < p:
                    self.show(
                        f"these pieces identify {identified} of {p} combinations of the unknowns: whole series may identify more, "
                        "but with fewer unknowns (--parameters) each value would be more precise"
                    )
            found = spread(self.gaps(longer, end), longer)
            if length == lengths[0]:
                self.doubt(len(longer), found, prior, lengths)
            if np.all(left < ALL_NOISE * self.noise) and np.any(found > LOSES * left):
                self.show("the motion is chaotic over pieces of this length: shorter pieces are kept")
                break
            x, z, pieces = end[:p], end, unpack(end, longer, p)
            # The shortest pieces are no reference: each has its own start, so any machine leaves little more than noise.
            left = np.maximum(found, self.noise) if length > lengths[0] else left
        self.machine.tolerance(TIGHT)
        return pieces, z, before

    def explain(self, pieces: list[Piece], z: Array, prior: Array, length: float) -> tuple[list[Piece], Array]:
        """Fits the unknowns stage by stage; the last stage fits all of them. Returns the pieces, with the assemblies that fit best, and the solution."""
        p = len(self.sought)
        stages = [
            next(k for k, (_, words) in enumerate(STAGES) if parameter.name.startswith(words))
            for parameter in self.sought
        ]
        self.free[:] = False
        for k in sorted(set(stages)):
            self.free |= np.array(stages) == k
            whole = bool(self.free.all())
            if not whole and np.all(spread(self.gaps(pieces, z), pieces) < ALL_NOISE * self.noise):
                continue
            end = self.stage(STAGES[k][0], pieces, z, prior, length)
            if whole or self.stages[-1].after < EXPLAINS * self.stages[-1].before:
                pieces = self.other_side(unpack(end, pieces, p), end[:p])
                z = pack(end[:p], pieces)
        return pieces, z

    def other_side(self, pieces: list[Piece], x: Array) -> list[Piece]:
        """Pieces with much larger residuals than most start in the other assembly if it fits better: with wrong unknowns, the choice was uncertain."""
        off = [self.off(piece, x) for piece in pieces]
        found = []
        for piece, residual in zip(pieces, off, strict=True):
            if residual > LOSES * float(np.median(off)):
                start = Start(guess(piece.path.samples), 3 - piece.start.assembly)
                other = self.begun(Piece(piece.path, start, piece.mask), x)
                piece = other if self.off(other, x) < residual else piece
            found.append(piece)
        return found

    def determined(self, pieces: list[Piece], z: Array) -> int:
        """Number of combinations of the unknowns that the pieces determine to `LIMIT`, by the last derivatives."""
        p = len(self.sought)
        sigma = np.maximum(spread(self.gaps(pieces, z), pieces), self.noise)
        rows = []
        for piece, derivative in zip(pieces, self.recent(pieces, z, False), strict=True):
            block = (derivative / sigma[:, None])[piece.mask]
            own, starts = block[:, :p], block[:, p:] / np.maximum(np.linalg.norm(block[:, p:], axis=0), 1e-300)
            rows.append(own - starts @ np.linalg.lstsq(starts, own, rcond=1e-9)[0])
        return int(np.sum(np.linalg.svd(np.vstack(rows), compute_uv=False) > 1 / LIMIT))

    def doubt(self, count: int, left: Array, prior: Array, lengths: list[float]) -> None:
        """Raises `TwinError` if another assumption explains the `count` shortest pieces far better than the fit, which leaves `left`, rad."""
        visible = left >= np.maximum(VISIBLE, 2 * ALL_NOISE * self.noise)
        if not visible.any():
            return
        if sentence := assumptions.held(self.data, np.where(visible, left, 0.0)):
            raise TwinError(sentence)
        others = list(assumptions.others(self.machine.scene, self.data.series[0].names))
        best = others[int(np.argmin([self.under(other, count, prior, lengths, False) for other in others]))]
        found = self.under(best, count, prior, lengths, True)
        if found < assumptions.SURE * float(np.mean(left)):
            raise TwinError(
                f"{best.sentence}: over pieces of {lengths[0]:g} s, residuals are {plain(1e3 * found, 2)} mrad with this change, "
                f"and {plain(1e3 * float(np.mean(left)), 2)} mrad without it"
            )

    def under(
        self, other: assumptions.Assumption, count: int, prior: Array, lengths: list[float], fitted: bool
    ) -> float:
        """Residuals of the shortest pieces under another assumption, rad, with the scene's values or with fitted ones; infinite if it fits few."""
        machine = Machine(self.machine.library, self.machine.scene | other.scene, self.sought)
        machine.tolerance(LOOSE)
        data = Data([other.samples(series) for series in self.data.series], [])
        fitter = Fitter(machine, data, self.between, self.longest, lambda _: None, self.patience)
        fitter.ends = self.ends
        x = np.array([parameter.start for parameter in self.sought])
        try:
            pieces = fitter.first(x, lengths)
            z = pack(x, pieces)
            if fitted:
                z = fitter.stage("", pieces, z, prior, lengths[0])
            return float(np.mean(spread(fitter.gaps(pieces, z), pieces))) if 2 * len(pieces) > count else math.inf
        except TimeLimitExceeded:
            raise
        except TwinError:
            return math.inf
        finally:
            machine.close()

    def stage(self, name: str, pieces: list[Piece], z: Array, prior: Array, length: float) -> Array:
        """Fits the free unknowns, and notes the residuals before and after."""
        gaps = self.gaps(pieces, z)
        self.leave_out(pieces, gaps, np.full(2, np.inf))
        before = rms(gaps, pieces)
        end, _ = self.settle(pieces, z, False, prior)
        after = rms(self.gaps(pieces, end), pieces)
        self.stages.append(Stage(name, min(length, self.span()), before, after))
        self.show(self.stages[-1].sentence())
        return end

    def finish(self, pieces: list[Piece], z: Array, outliers: int, rms_before: float) -> Fit:
        """Residuals, derivatives and the error of the derivatives at the solution."""
        p = len(self.sought)
        gaps = self.gaps(pieces, z)
        # All three belong to the same point: otherwise, the distance of the points would look like an error.
        if (
            self.finished is None
            or len(z) != len(self.finished[0])
            or self.moved(self.finished[1][0], z - self.finished[0]) > STILL
        ):
            self.finished = z.copy(), [self.derivatives(pieces, z, times) for times in (1.0, 2.0, 4.0)]
        one, two, four = self.finished[1]
        size = sum(int(piece.mask.sum()) for piece in pieces)
        jacobian, doubt = np.zeros((size, len(z))), np.zeros((size, len(z)))
        rows = np.zeros((size, 3), dtype=int)
        row = 0
        squares, counts = np.zeros(2), np.zeros(2)
        for number, piece in enumerate(pieces):
            inside = slice(row, row + int(piece.mask.sum()))
            # Richardson extrapolation to step 0; the same from twice the steps gives the error.
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
            self.stages,
        )

    def leave_out(self, pieces: list[Piece], gaps: list[Array], sigma: Array) -> int:
        """Excludes outliers and returns their number: residuals that jump relative to their neighbours, and very large ones.

        Errors of an incomplete fit change smoothly and are no outliers.
        """
        leaps = [np.abs(gap - around(gap)) for gap in gaps]
        usual = np.maximum(spread(leaps, pieces), self.noise)
        usable = [self.compared(piece.path.samples) for piece in pieces]
        # Several jumps close together are an error of the fit, not of a sample.
        alone = [leap / np.maximum(usual, np.nan_to_num(around(leap, 10))) for leap in leaps]
        leapt = beyond(usable, alone, np.full(2, OUTLIER))
        # Large residuals count as outliers once the residuals are near the noise estimated from third differences of the samples.
        reached = bool(np.all(sigma < 50 * self.noise))
        far = beyond(usable, [np.abs(gap) for gap in gaps], 2 * OUTLIER * sigma if reached else np.full(2, np.inf))
        for piece, mask, *out in zip(pieces, usable, leapt, far, strict=True):
            piece.mask = mask & ~out[0] & ~out[1]
        return sum(int(mask.sum() - piece.mask.sum()) for mask, piece in zip(usable, pieces, strict=True))

    def span(self) -> float:
        """Duration of the longest series, s."""
        return max(float(series.time[-1] - series.time[0]) for series in self.data.series)


def expected(fit: Fit, prior: Array, origin: Array) -> Array:
    """Unknowns and starts of the least squares with another prior, to first order; `prior` as in `Fitter.solve`."""
    p = len(fit.x)
    weights = 1 / fit.sigma[fit.rows[:, 2]]
    gaps = np.array([fit.residuals[piece][row, encoder] for piece, row, encoder in fit.rows.tolist()])
    jacobian = np.vstack([fit.jacobian * weights[:, None], np.pad(prior, ((0, 0), (0, fit.jacobian.shape[1] - p)))])
    scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    step = np.linalg.lstsq(jacobian / scale, np.concatenate([gaps * weights, prior @ (origin - fit.x)]), rcond=None)[0]
    return np.asarray(pack(fit.x, fit.pieces) + step / scale)


def least_noise(data: Data) -> Array:
    """Lower limit for the standard deviation of each encoder, rad: a tenth of its noise in third differences, and more than 0."""
    found = []
    for i in (0, 1):
        thirds = np.concatenate([np.diff(s.angles[:, i], 3) for s in data.series])
        thirds = thirds[np.isfinite(thirds)]
        found.append(0.1 * 1.4826 * float(np.median(np.abs(thirds))) / math.sqrt(20) if len(thirds) else 0.0)
    return np.maximum(found, 1e-9)


def beyond(usable: list[Array], sizes: list[Array], limits: Array) -> list[Array]:
    """Masks of the samples beyond their encoder's limit; at most the share `FEW` with the largest excess.

    A larger share means that the fit has not converged, or that the machine is another one.
    """
    ratios = [np.where(mask, np.nan_to_num(size) / limits, 0.0) for mask, size in zip(usable, sizes, strict=True)]
    every = np.concatenate([ratio[mask] for ratio, mask in zip(ratios, usable, strict=True)])
    limit = max(1.0, float(np.quantile(every, 1 - FEW))) if len(every) else 1.0
    return [ratio > limit for ratio in ratios]


def most_outliers(readings: int) -> int:
    """Largest number of outliers that `beyond` finds among so many readings."""
    return math.ceil(FEW * (readings - 1) - 1e-9)


def around(gap: Array, reach: int = 4) -> Array:
    """Median of the neighbours of each residual, (n, 2)."""
    padded = np.pad(gap, ((reach, reach), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0)
    with warnings.catch_warnings():
        # numpy warns about windows without a sample.
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmedian(windows, axis=2))


def guess(samples: Samples) -> Array:
    """Angles and rates at the first sample, from parabolas through the first samples without outliers."""
    state = np.zeros(4)
    for i in (0, 1):
        known = np.flatnonzero(np.isfinite(samples.angles[:, i]))[:9]
        if len(known) < 3:
            raise TwinError(
                f"a series has {len(known)} samples of measured.theta[{i + 1}]; its start needs 3 or more of both encoders"
            )
        time, angle = samples.time[known] - samples.time[0], np.unwrap(samples.angles[known, i])
        while True:
            fitted = np.polynomial.polynomial.polyfit(time, angle, min(2, len(time) - 1))
            off = np.abs(angle - np.polynomial.polynomial.polyval(time, fitted))
            # Remove one outlier at a time while enough samples are left.
            if len(time) < 6 or off.max() < 4 * np.median(off) or off.max() < 1e-6:
                break
            time, angle = np.delete(time, off.argmax()), np.delete(angle, off.argmax())
        state[i], state[2 + i] = fitted[0], fitted[1]
    return state


def pack(x: Array, pieces: list[Piece]) -> Array:
    """Unknowns and starts as one vector."""
    return np.concatenate([x, *(piece.start.state for piece in pieces)])


def unpack(z: Array, pieces: list[Piece], p: int) -> list[Piece]:
    """The pieces with the starts from a vector."""
    return [
        Piece(piece.path, Start(z[p + 4 * k : p + 4 * k + 4], piece.start.assembly), piece.mask)
        for k, piece in enumerate(pieces)
    ]


def spread(gaps: list[Array], pieces: list[Piece]) -> Array:
    """Standard deviations of both encoders' residuals, rad, estimated from medians."""
    found = []
    for i in (0, 1):
        values = np.concatenate([np.abs(gap[:, i][piece.mask[:, i]]) for gap, piece in zip(gaps, pieces, strict=True)])
        found.append(1.4826 * float(np.median(values)) if len(values) else 0.0)
    return np.array(found)


def rms(gaps: list[Array], pieces: list[Piece]) -> float:
    """Root mean square of the residuals in the median piece, rad, because a few short pieces may have wrong starts."""
    squares = [np.mean(gap[piece.mask] ** 2) for gap, piece in zip(gaps, pieces, strict=True) if piece.mask.any()]
    return math.sqrt(float(np.median(squares)))


def wrapped(angle: Array) -> Array:
    """Wraps angles to half a turn on either side of 0, rad."""
    return angle - 2 * math.pi * np.round(angle / (2 * math.pi))
