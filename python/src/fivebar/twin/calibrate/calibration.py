"""Calibration of a machine from a record: the unknowns, the fits and the results.

`calibrate` implements `fivebar.calibrate`; the command takes the same steps.
"""

import json
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, TypeVar, get_args

import numpy as np

from fivebar import scene as scenes_of
from fivebar.errors import warn
from fivebar.library import Library, shared
from fivebar.links import doubts
from fivebar.plain import plain
from fivebar.scene import Scene
from fivebar.scene_file import OFFSETS
from fivebar.twin import recording
from fivebar.twin.calibrate import data, scenes
from fivebar.twin.calibrate.fit import ALL_NOISE, Fit, Fitter, Show, TimeLimitExceeded, least_noise, most_outliers
from fivebar.twin.calibrate.identify import Judgement, interval, judge
from fivebar.twin.calibrate.motion import Between, Machine
from fivebar.twin.calibrate.parameters import USUAL, Parameter, Values, assemble, parameters, trusted
from fivebar.twin.errors import TwinError
from fivebar.twin.recording import Array

log = logging.getLogger("fivebar")

T = TypeVar("T")

WELL_TOLD: Final = 0.05
"""Standard deviation, in sizes."""

WRONG: Final = 0.05
"""Residuals, rad, of a machine that is not the scene's; noise of encoders and unmodelled effects are far below."""

ODD: Final = 10.0
"""Ratio of residuals to the noise of the encoders up to which there is no warning; residuals below `SMALL` never cause one."""

CONSTANT: Final = 0.2
"""Standard deviation of residuals that count as constant, relative to their median."""

SMALL: Final = 1e-3
"""Residuals before the fit, rad, below which the scene is of this machine."""


CONTRADICTED: Final = 2.0
"""Ratio of residuals above which the scene's values of unidentified unknowns are wrong: residuals with these values fixed over residuals with
them free (noise only)."""


@dataclass(frozen=True)
class Solution:
    """The last fit and its judgement."""

    fit: Fit
    judgement: Judgement
    sought: list[Parameter]
    wrong: str = ""
    """Why the results are rejected, or ""."""

    odd: str = ""
    """Why errors may exceed the error bars, or ""."""

    def refused(self) -> list[int]:
        """Indices of the unknowns that the record does not identify."""
        return [k for k, known in enumerate(self.judgement.identified) if not known]


@dataclass(frozen=True)
class Problem:
    """A record, the assumed machine, and the unknowns."""

    library: Library
    name: str
    """Name of the record."""

    record: data.Data
    assumed: scenes.Assumed
    sought: list[Parameter]
    taken: Array
    """Prior standard deviations of the scene's values, in sizes."""

    def solve(self, commands: Between, longest: float, patience: float, show: Show) -> "Calibration":
        """Fits and judges the unknowns; raises TimeLimitExceeded if the time limit ends the first fit."""
        _check_positive("longest", longest)
        _check_positive("patience", patience)
        if commands not in get_args(Between):
            raise TwinError(f"commands are {commands!r:.60}; one of {', '.join(get_args(Between))} is needed")
        machine = Machine(self.library, self.assumed.machine, self.sought)
        try:
            return Calibration(self, solve(machine, self.record, commands, longest, show, patience, self.taken))
        finally:
            machine.close()


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """Result of a calibration: values with error bars, pictures, and the scene of the calibrated machine.

    Examples
    --------
    >>> import fivebar
    >>> run = fivebar.run("pick_and_place", stop_time=1.5, **{"payload.mass": 0.06})
    >>> found = fivebar.calibrate(run, "pick_and_place", ["payload.mass"], commands="hold")
    >>> found
    <fivebar calibration: payload.mass = 0.06 ± ... kg>
    >>> [picture.name for picture in found.pictures("pictures")]
    ['residuals.png', 'unknowns.png']
    """

    problem: Problem
    solution: Solution

    def __repr__(self) -> str:
        found = [
            f"{name} = {value:.5g} ± {self.bars[name]:.2g} {self.units[name]}" for name, value in self.values.items()
        ]
        return f"<fivebar calibration: {', '.join(found) or 'nothing is identified'}>"

    @cached_property
    def values(self) -> dict[str, float]:
        """Identified values by variable, SI; a group such as `link[1,4].mass` has a value for each member."""
        return self._members(lambda k, p: p.value(float(self.solution.fit.x[k])))

    @cached_property
    def bars(self) -> dict[str, float]:
        """Half-widths of the 95 % intervals by variable."""
        return self._members(lambda k, p: p.bar(interval(float(self.solution.judgement.sigma[k]))))

    @cached_property
    def bounds(self) -> dict[str, float]:
        """Smallest possible half-widths for white noise (Cramér and Rao)."""
        return self._members(lambda k, p: p.bar(interval(float(self.solution.judgement.bound[k]))))

    @cached_property
    def units(self) -> dict[str, str]:
        """Units by variable."""
        return self._members(lambda _, p: (p.unit,) * len(p.base))

    @property
    def correlations(self) -> dict[str, dict[str, float]]:
        """Correlations between all unknowns, by name."""
        names = [p.name for p in self.solution.sought]
        rows = self.solution.judgement.correlation.tolist()
        return {name: dict(zip(names, row, strict=True)) for name, row in zip(names, rows, strict=True)}

    @property
    def not_identified(self) -> list[str]:
        """Sentences about unknowns that the record does not identify."""
        return self.solution.judgement.not_identified(self.solution.sought)

    @property
    def warning(self) -> str:
        """Why the results are rejected, or why errors may exceed the error bars; "" without a reason."""
        return self.solution.wrong or self.solution.odd

    @property
    def residuals(self) -> tuple[float, float]:
        """Standard deviations of the residuals of both encoders, rad."""
        left, right = self.solution.fit.sigma.tolist()
        return left, right

    def _members(self, of: Callable[[int, Parameter], Sequence[T]]) -> dict[str, T]:
        """The values of `of` for each identified variable."""
        found: dict[str, T] = {}
        for k, p in enumerate(self.solution.sought):
            if self.solution.judgement.identified[k]:
                found |= zip(p.members or (p.name,), of(k, p), strict=True)
        return found

    def start(self) -> Values:
        """Start values with the estimates; other values stay as assumed, also centres of mass and inertias of links with estimated lengths or masses."""
        found = [
            (p, float(x) if known else p.origin)
            for p, x, known in zip(
                self.solution.sought, self.solution.fit.x, self.solution.judgement.identified, strict=True
            )
            if known or p.name.endswith((".com", ".inertia"))
        ]
        return assemble(
            self.problem.assumed.machine, self.problem.library, [p for p, _ in found], [x for _, x in found]
        )

    def content(self) -> dict[str, Any]:
        """The scene of the calibrated machine as the content of a file, with the start of the record and the assumed settings of estimator and solver.

        Raises FiveBarError if nothing is identified.
        """
        if not self.values:
            raise TwinError(f"{self.problem.name} identifies nothing: there is no calibrated scene")
        known = [
            self.solution.sought[k].name
            for k, is_identified in enumerate(self.solution.judgement.identified)
            if is_identified
        ]
        unknown = [self.solution.sought[k].name for k in self.solution.refused()]
        text = f"Calibrated from {self.problem.name}: {scenes.series(known)}."
        if unknown:
            text += f" Not identified, with values as before: {scenes.series(unknown)}."
        fit = self.solution.fit
        first = fit.pieces[0].start
        values = self.start()
        offsets = np.array([float(values.get(name, 0.0)) for name in OFFSETS])
        begin = first.state[:2] + fit.machine.offsets(fit.x) - offsets
        values |= {f"init.theta[{i}]": float(angle) for i, angle in enumerate(begin, 1)}
        values |= {f"init.omega[{i}]": float(rate) for i, rate in enumerate(first.state[2:], 1)}
        values["init.assembly"] = first.assembly
        # First commands of the drives as start values: without a master the machine holds its posture.
        x = np.where(self.solution.judgement.identified, fit.x, [p.origin for p in self.solution.sought])
        commands = fit.pieces[0].path.first(offsets, fit.machine.constants(x))
        values |= {name: value for name, value in commands.items() if not name.startswith("servo.omega")}
        if values.get("servo.enabled", False):
            values |= fit.machine.held(list(commands), offsets)
        time = self.problem.record.series[0].time
        stop = round(time[-1] - time[0], 6) or 1.0
        return scenes_of.content(text, self.problem.assumed.settings | values, stop, 1e-3, self.problem.library.known)

    def scene(self) -> Scene:
        """The calibrated machine as a scene for `fivebar.run`, `fivebar.unit` and `fivebar.Unit`.

        Raises FiveBarError if nothing is identified.
        """
        return scenes_of.parse("calibrated", json.dumps(self.content()), self.problem.library.known)

    def pictures(self, folder: str | Path) -> list[Path]:
        """Draws residuals, error bars and correlations into a folder; returns the files."""
        from fivebar.twin.calibrate import pictures

        Path(folder).mkdir(parents=True, exist_ok=True)
        return pictures.draw(Path(folder), self.solution.fit, self.solution.judgement, self.solution.sought)

    @cached_property
    def impossible(self) -> list[str]:
        """Sentences about impossible values of the calibrated machine."""
        return doubts(dict(self.problem.library.known.start) | self.start())

    def figures(self) -> dict[str, Any]:
        """All results, as values for JSON."""
        fit, judgement, given = self.solution.fit, self.solution.judgement, self.problem.record
        unknowns = {}
        for k, p in enumerate(self.solution.sought):
            members = p.members or (p.name,)
            of_members = {
                key: {name: found[name] for name in members} if judgement.identified[k] else None
                for key, found in (("value", self.values), ("bar95", self.bars), ("bound95", self.bounds))
            }
            unknowns[p.name] = {
                "identified": judgement.identified[k],
                "unit": p.unit,
                "scene": dict(zip(members, p.base, strict=True)),
                **of_members,
                "derivative_error": float(judgement.doubt[k]),
            }
        return {
            "refused": self.solution.wrong or None,
            "warning": self.solution.odd or None,
            "begins_from": self.problem.assumed.source,
            "samples": sum(len(series) for series in given.series),
            "series": len(given.series),
            "period": given.period,
            "notes": given.notes,
            "outliers": fit.outliers,
            "residuals_rad": {"before": fit.rms_before, "encoder": fit.sigma.tolist()},
            "stages": [asdict(stage) for stage in fit.stages],
            "samples_as_one": judgement.together.time_scale,
            "unknowns": unknowns,
            "correlations": {p.name: judgement.correlation[k].tolist() for k, p in enumerate(self.solution.sought)},
            "not_identified": self.not_identified,
            "impossible": self.impossible,
            "runs": fit.machine.runs,
        }

    def summary(self) -> str:
        """Text for the command: samples, residuals, values with error bars, unidentified unknowns."""
        fit, judgement, given = self.solution.fit, self.solution.judgement, self.problem.record
        count = sum(len(series) for series in given.series)
        lines = [self.warning] if self.warning else []
        periods = recording.distinct(np.array([series.period for series in given.series]))
        every = " or ".join(f"{1e3 * period:.3g}" for period in periods)
        lines.append(
            f"{count} samples in {len(given.series)} series, every {every} ms; begun from {self.problem.assumed.source}"
        )
        lines += [f"  {note}" for note in given.notes if note != given.coarse]
        lines.append(residuals(fit, judgement.together.time_scale, bool(self.solution.wrong), bool(self.warning)))
        lines += [f"  {stage.sentence()}" for stage in fit.stages]
        lines += ["", f"  {'':28} {'scene':>12} {'found':>14} {'± 95 %':>11} {'bound 95 %':>11}"]
        for k, p in enumerate(self.solution.sought):
            first = (p.members or (p.name,))[0]
            found = (
                f"{self.values[first]:14.7g} {self.bars[first]:11.2g} {self.bounds[first]:11.2g}  {p.unit}"
                if judgement.identified[k]
                else f"{'not identified':>14}"
            )
            lines.append(f"  {p.name:28} {p.base[0]:12.6g} {found}")
        lines += [f"warning: {sentence}" for sentence in self.impossible]
        lines += [f"not identified: {sentence}" for sentence in self.not_identified]
        doubt = [doubt if known else 0.0 for doubt, known in zip(judgement.doubt, judgement.identified, strict=True)]
        worst = int(np.argmax(doubt))
        lines.append(
            f"derivatives: twice the step differs by {judgement.doubt[worst]:.1g} of the column at most ({self.solution.sought[worst].name})"
        )
        return "\n".join(lines)


def prepare(
    record: Any,
    scene: str | Path | Mapping[str, Any] | Scene | None,
    names: Sequence[str],
    library: Library,
    begin: float,
    seconds: float,
    unit: str,
) -> Problem:
    """Reads a record and resolves the unknowns; arguments as for `fivebar.calibrate`."""
    _check_positive("seconds", seconds)
    given = data.read(record, begin, seconds, unit)
    data.check(given)
    assumed = scenes.assumed(scene, record, library)
    if doubt := data.unled(given, {**library.known.start, **assumed.machine}):
        warn(doubt)
    given = data.turned(given, library, assumed.machine)
    sought = parameters(names or usual(assumed.machine), library, assumed.machine)
    # A length that the user names as unknown gets no prior from the scene.
    taken = np.full(len(sought), np.inf) if names else trusted(sought, library)
    name = Path(record).name if isinstance(record, Path) else recording.GIVEN
    return Problem(library, name, given, assumed, sought, taken)


def calibrate(
    record: Any,
    scene: str | Path | Mapping[str, Any] | Scene | None = None,
    names: Sequence[str] = (),
    *,
    begin: float = 0.0,
    seconds: float = 10.0,
    longest: float = 10.0,
    commands: Between = "rate",
    patience: float = 120.0,
    unit: str = "",
    fmu: str | Path | None = None,
) -> Calibration:
    """Implements `fivebar.calibrate`; `names` are its `parameters`."""
    record = Path(record) if isinstance(record, str) else record
    library = shared(Path(fmu) if fmu else None)
    names = (names,) if isinstance(names, str) else names
    return prepare(record, scene, names, library, begin, seconds, unit).solve(commands, longest, patience, log.info)


def _check_positive(name: str, value: float) -> None:
    if not value > 0:
        raise TwinError(f"{name} is {value:g}; more than 0 is needed")


def solve(
    machine: Machine,
    given: data.Data,
    between: Between,
    longest: float,
    show: Show,
    patience: float = math.inf,
    taken: np.ndarray | None = None,
) -> Solution:
    """Fits; then fits again with unidentified unknowns at the scene's values, fixed or with a prior.

    `taken`: prior standard deviations of the scene's values, in sizes; infinite, which fixes them, by default.
    """
    fitter = Fitter(machine, given, between, longest, show, patience)
    sought = list(machine.sought)
    free = np.full(len(sought), np.inf)
    taken = free if taken is None else taken
    fit = alone = fitter.run()
    first = judge(fit, sought, free)
    held = np.where(first.sigma > taken, taken, np.inf)
    judgement = judge(fit, sought, held) if np.any(held < free) else first
    pins = np.empty((0, len(sought)))
    for settled in (bool(np.all(held == free)) and float(np.max(judgement.sigma)) < WELL_TOLD, True, True):
        doubtful = ~np.array(judgement.identified) & (taken < held)
        if np.any(doubtful):
            # A pin at the scene's value would be exact, but the machine may differ from it by `taken`.
            held = np.where(doubtful, taken, held)
            again = judge(fit, sought, held)
            judgement = replace(_both(judgement, again), combinations=again.combinations)
        before = len(pins)
        pins = _pins(judgement, len(sought))
        # The prior moves no unknown that is identified this well.
        if len(pins) == before and settled and not np.any(doubtful):
            break
        if names := [p.name for p, known in zip(sought, judgement.identified, strict=True) if not known]:
            show(f"not identified: {', '.join(names)}; fitted once more with these at their values in the scene")
        try:
            later = fitter.again(fit, pins, held)
        except TimeLimitExceeded:
            show(
                "no time is left for this repetition (--patience): the fit before stays, and no value is believed that no repetition has confirmed"
            )
            if fit is alone:
                # Combinations that are not identified may have moved the other unknowns by more than their bars.
                judgement = replace(first, identified=[False] * len(sought))
            break
        if not (np.all(fit.sigma < ALL_NOISE * fitter.noise) and np.any(later.sigma > CONTRADICTED * fit.sigma)):
            fit, judgement = later, _both(judgement, judge(later, sought, held))
        elif np.any(held < free):
            show("residuals are larger with the scene's lengths and mounting angles: these are not the machine's")
            judgement, held, taken, pins = first, free, free, np.empty((0, len(sought)))
        else:
            show("with these values of the scene residuals are larger: the previous fit is kept")
            break
    wrong, odd = suspicion(fit, least_noise(given))
    if wrong:
        judgement = replace(judgement, identified=[False] * len(sought))
    return Solution(fit, judgement, sought, wrong, odd)


def residuals(fit: Fit, time_scale: float, is_refused: bool, is_doubtful: bool) -> str:
    """A line about the residuals. `time_scale` is the number of successive ones that count as one."""
    sigma = ", ".join(plain(1e3 * value) for value in fit.sigma.tolist())
    found = f"residuals {sigma} mrad (encoders 1, 2), {fit.outliers} outliers left out"
    if fit.outliers >= most_outliers(len(fit.rows) + fit.outliers):
        found += ", as many as are allowed: other readings may be wrong, too"
    if time_scale != 1.0 and not is_refused:
        found += f"; {time_scale:.0f} residuals count as one"
    elif time_scale == 1.0 and not is_doubtful:
        # White residuals speak for a fit only if they are small.
        found += "; the residuals are white"
    return found


def constant(fit: Fit, encoder: int) -> str:
    """The end of a sentence, about the zero of an encoder, if its residuals hardly change, else ""."""
    every = np.concatenate(
        [gaps[piece.mask[:, encoder], encoder] for piece, gaps in zip(fit.pieces, fit.residuals, strict=True)]
    )
    middle, change = float(np.median(every)), float(np.std(every))
    if not change < CONSTANT * abs(middle):
        return ""
    return (
        f"; the residuals are constant within {plain(1e3 * change, 2)} mrad, as if the zero of this encoder were {middle:+.4f} rad off "
        f'(in a map of `fivebar import`, add {-middle:+.4f} to its "offset")'
    )


def suspicion(fit: Fit, tenth: np.ndarray) -> tuple[str, str]:
    """Why a fit is rejected, and why its errors may exceed the error bars; "" without a reason."""
    worst = int(np.argmax(fit.sigma))
    residual, shown = float(fit.sigma[worst]), 10 * float(tenth[worst])
    text = f"residuals of encoder {worst + 1} are {plain(1e3 * residual)} mrad after the fit, with encoder noise of {plain(1e3 * shown, 2)} mrad"
    if residual > WRONG and fit.rms_before < SMALL:
        return (
            f"refused: the fit failed: {text}. Before the fit they were {plain(1e3 * fit.rms_before, 2)} mrad, over short pieces with the scene's values: the results are rejected",
            "",
        )
    zero = constant(fit, worst)
    if residual > WRONG:
        return f"refused: {text}: the scene is not this machine, so the results are rejected{zero}", ""
    if residual > max(ODD * shown, SMALL):
        return (
            "",
            f"warning: {text}: the machine has an effect that is not fitted, so values may be off by more than their error bars{zero}",
        )
    return "", ""


def _both(before: Judgement, later: Judgement) -> Judgement:
    """Judgement of the later fit, with an unknown identified only if both fits identify it."""
    identified = [a and b for a, b in zip(before.identified, later.identified, strict=True)]
    combinations = max(later.combinations, before.combinations, key=len)
    return replace(later, identified=identified, combinations=combinations, bounded=later.bounded | before.bounded)


def _pins(judgement: Judgement, count: int) -> np.ndarray:
    """Sentences about combinations that are not identified, and about other unidentified unknowns without a prior."""
    rows = [combination.weights for combination in judgement.combinations]
    for k, known in enumerate(judgement.identified):
        if not known and not np.isfinite(judgement.held[k]) and not any(abs(row[k]) > 0.1 for row in rows):
            rows.append(np.eye(count)[k])
    return np.array(rows) if rows else np.empty((0, count))


def usual(scene: Values) -> list[str]:
    """Names of the default unknowns: the part of `USUAL` that the scene has."""
    left_out = [] if scene.get("payload.enabled", False) else ["payload.mass"]
    left_out += [] if scene.get("gravity.enabled", True) else ["gravity.direction"]
    return [name for name in USUAL if name not in left_out]
