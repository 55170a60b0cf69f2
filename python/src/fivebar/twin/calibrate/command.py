"""`fivebar calibrate FILE`: parameters of the machine from samples of its encoders."""

import json
import math
import shlex
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from fivebar import shipped
from fivebar.library import Library
from fivebar.links import doubts
from fivebar.scene import write as write_scene
from fivebar.scene_file import OFFSETS
from fivebar.twin.calibrate import data, scenes
from fivebar.twin.calibrate.fit import ALL_NOISE, Fit, Fitter, GivenUp, Show, least_noise
from fivebar.twin.calibrate.identify import Judgement, interval, judge
from fivebar.twin.calibrate.motion import Between, Machine
from fivebar.twin.calibrate.parameters import USUAL, Parameter, Values, assemble, parameters, trusted
from fivebar.twin.calibrate.propose import SECONDS, Motion, propose
from fivebar.twin.errors import TwinError


@dataclass(frozen=True)
class Options:
    """Options of a calibration: the record, the unknowns, the fit."""

    file: Path
    """A record: Parquet, a folder of parts, or CSV."""

    parameters: tuple[str, ...]
    """Unknowns by name; none means `USUAL`."""

    scene: str | Path | None
    """Scene with the assumed parameters of the machine; without one that of the record."""

    begin: float
    """s after the first sample."""

    seconds: float
    """Of the record that are used."""

    longest: float
    """s: longer series are cut."""

    commands: Between
    """Course of the commands between samples."""

    patience: float
    """s of CPU after which a fit is given up."""

    unit: str
    """Name of the machine, if the record has several."""

    proposal: bool
    """Whether to look for a motion that would tell what is not identified."""

    fmu: Path
    out: Path


WELL_TOLD: Final = 0.05
"""Standard deviation in sizes."""

WRONG: Final = 0.05
"""rad: residuals of a machine that is not the scene's; noise of encoders and unmodelled effects are far below."""

ODD: Final = 10.0
"""Ratio of residuals to the noise of the encoders up to which there is no warning; residuals below `SMALL` never cause one."""

SMALL: Final = 1e-3
"""rad; residuals of less before the fit are those of a scene that is this machine's."""


CONTRADICTED: Final = 2.0
"""Ratio of the residuals with the scene's values of what is not identified to those without, noise alone, above which these values are not the
machine's."""


@dataclass(frozen=True)
class Result:
    """A calibration."""

    fit: Fit
    judgement: Judgement
    sought: list[Parameter]
    wrong: str = ""
    """Why nothing is believed, or ""."""

    odd: str = ""
    """Why values may be off by more than their bars, or ""."""

    def refused(self) -> list[int]:
        """Indices of the unknowns that the record does not identify."""
        return [k for k, known in enumerate(self.judgement.identified) if not known]


def calibrate(
    machine: Machine,
    given: data.Data,
    between: Between,
    longest: float,
    show: Show,
    patience: float = math.inf,
    taken: np.ndarray | None = None,
) -> Result:
    """Fits; then once more with the unknowns that are not identified held at the scene's values.

    `taken`: standard deviations, in sizes, with which the scene's values are taken as right where the record tells less; by default infinite.
    """
    fitter = Fitter(machine, given, between, longest, show, patience)
    sought = list(machine.sought)
    free = np.full(len(sought), np.inf)
    fit = fitter.run()
    first = judge(fit, sought, free)
    held = free if taken is None else np.where(first.sigma > taken, taken, np.inf)
    judgement = judge(fit, sought, held) if np.any(held < free) else first
    pins = np.empty((0, len(sought)))
    for settled in (bool(np.all(held == free)) and float(np.max(judgement.sigma)) < WELL_TOLD, True, True):
        told = len(pins)
        pins = _pins(judgement, len(sought))
        # The prior moves no unknown that is identified this well.
        if len(pins) == told and settled:
            break
        if names := [p.name for p, known in zip(sought, judgement.identified, strict=True) if not known]:
            show(f"not identified: {', '.join(names)}; fitted once more with that as it is in the scene")
        later = fitter.again(pins, held)
        if not (np.all(fit.sigma < ALL_NOISE * fitter.noise) and np.any(later.sigma > CONTRADICTED * fit.sigma)):
            fit, judgement = later, _both(judgement, judge(later, sought, held))
        elif np.any(held < free):
            show("residuals are larger with the scene's lengths and mounting angles: these are not the machine's")
            judgement, held, pins = first, free, np.empty((0, len(sought)))
        else:
            show("with that as it is in the scene residuals are larger: the fit before stays")
            break
    wrong, odd = suspicion(fit, least_noise(given))
    if wrong:
        judgement = replace(judgement, identified=[False] * len(sought))
    return Result(fit, judgement, sought, wrong, odd)


def suspicion(fit: Fit, tenth: np.ndarray) -> tuple[str, str]:
    """Why nothing of a fit is to be believed, and why it is to be believed less than its bars say; "" if there is no reason."""
    worst = int(np.argmax(fit.sigma))
    residual, shown = float(fit.sigma[worst]), 10 * float(tenth[worst])
    text = f"residuals of encoder {worst + 1} are {1e3 * residual:.3g} mrad after the fit, where the encoder shows {1e3 * shown:.2g} mrad of noise"
    if residual > WRONG and fit.rms_before < SMALL:
        return (
            f"refused: the fit failed: {text}, and were {1e3 * fit.rms_before:.2g} mrad before it, with the scene's values over short pieces; nothing that was found is believed",
            "",
        )
    if residual > WRONG:
        return f"refused: {text}: the scene is not this machine, and nothing that was found is believed", ""
    if residual > max(ODD * shown, SMALL):
        return (
            "",
            f"warning: {text}: the machine has something that is not sought, and values may be off by more than their bars",
        )
    return "", ""


def _both(before: Judgement, later: Judgement) -> Judgement:
    """Judgement of the later fit, with an unknown identified only if both fits identify it."""
    identified = [a and b for a, b in zip(before.identified, later.identified, strict=True)]
    combinations = max(later.combinations, before.combinations, key=len)
    return replace(later, identified=identified, combinations=combinations, bounded=later.bounded | before.bounded)


def _pins(judgement: Judgement, count: int) -> np.ndarray:
    """Combinations that are not told, and unknowns that are not although neither a combination says why nor the scene's value holds them."""
    rows = [combination.weights for combination in judgement.combinations]
    for k, known in enumerate(judgement.identified):
        if not known and not np.isfinite(judgement.held[k]) and not any(abs(row[k]) > 0.1 for row in rows):
            rows.append(np.eye(count)[k])
    return np.array(rows) if rows else np.empty((0, count))


def run(options: Options) -> int:
    """0 if at least one unknown is identified, 1 if none is or the record is not of this machine."""
    for name in ("seconds", "longest", "patience"):
        if not (math.isfinite(getattr(options, name)) and getattr(options, name) > 0):
            raise TwinError(f"{name} is {getattr(options, name):g}; more than 0 is needed")
    begun = time.process_time()
    given = data.read(options.file, options.begin, options.seconds, options.unit)
    data.check(given)
    library = Library(options.fmu)
    try:
        scene, source = scenes.start_values(options.scene, options.file, library)
        given = data.turned(given, library, scene)
        sought = parameters(options.parameters or usual(scene), library, scene)
        machine = Machine(library, scene, sought)
        # Who asks for a length by its name takes the scene's for no better than the record's.
        taken = trusted(sought, library) if not options.parameters else np.full(len(sought), np.inf)
        options.out.mkdir(parents=True, exist_ok=True)
        # Those of an earlier record would be taken for this one's.
        calibrated, proposed = (options.out / name for name in ("calibrated.json", "proposal.json"))
        for file in (calibrated, proposed):
            if options.scene is None or Path(options.scene).resolve() != file.resolve():
                file.unlink(missing_ok=True)
        unknown = np.full(len(sought), np.inf)
        try:
            result = calibrate(machine, given, options.commands, options.longest, _show, options.patience, taken)
        except GivenUp:
            if options.proposal:
                motion = propose(library, scene, sought, taken, np.full(2, SMALL), unknown)
                _say_proposal(_write_proposal(proposed, motion, sought, unknown, library, options.fmu))
            raise
        proposal = None
        if result.refused() and not result.wrong and options.proposal:
            motion = propose(library, scene, sought, taken, np.minimum(result.fit.sigma, SMALL), result.judgement.sigma)
            proposal = _write_proposal(proposed, motion, sought, result.judgement.sigma, library, options.fmu)
        whole = dict(library.known.start) | fitted_values(result, scene, library)
        report = _report(result, given, source, options, time.process_time() - begun, proposal, doubts(whole))
        (options.out / "calibration.json").write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
        written = [options.out / "calibration.json"]
        if any(result.judgement.identified):
            written.insert(0, calibrated)
            _write_scene(calibrated, result, scene, options, given, library)
        machine.close()
    finally:
        library.close()
    from fivebar.twin.calibrate import pictures

    files = pictures.draw(options.out, result.fit, result.judgement, result.sought)
    _print(result, report, [*written, *files])
    return 0 if any(result.judgement.identified) else 1


def _show(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def usual(scene: Values) -> list[str]:
    """Names of the default unknowns: those of `USUAL` that the scene has."""
    left_out = [] if scene.get("payload.enabled", False) else ["payload.mass"]
    left_out += [] if scene.get("gravity.enabled", True) else ["gravity.direction"]
    return [name for name in USUAL if name not in left_out]


def fitted_values(result: Result, scene: Values, library: Library) -> Values:
    """Start values with the estimates; what is not identified stays as it is in the scene."""
    kept = [k for k, known in enumerate(result.judgement.identified) if known]
    return assemble(scene, library, [result.sought[k] for k in kept], [float(result.fit.x[k]) for k in kept])


def _write_scene(
    file: Path, result: Result, scene: Values, options: Options, given: data.Data, library: Library
) -> None:
    known = [p.name for p, identified in zip(result.sought, result.judgement.identified, strict=True) if identified]
    unknown = [result.sought[k].name for k in result.refused()]
    text = f"Calibrated from {options.file.name}: {scenes.series(known)}."
    if unknown:
        text += f" Not identified, and as before: {scenes.series(unknown)}."
    first = result.fit.pieces[0].start
    values = fitted_values(result, scene, library)
    shown = first.state[:2] + result.fit.machine.offsets(result.fit.x)
    offsets = np.array([float(values.get(name, 0.0)) for name in OFFSETS])
    values |= {f"init.theta[{i}]": float(angle) for i, angle in enumerate(shown - offsets, 1)}
    values |= {f"init.omega[{i}]": float(rate) for i, rate in enumerate(first.state[2:], 1)}
    values["init.assembly"] = first.assembly
    # First commands of the drives as start values: without a master the machine stays there.
    values |= {
        name: value
        for name, value in result.fit.pieces[0].path.first(offsets).items()
        if not name.startswith("servo.omega")
    }
    write_scene(
        file, text, values, round(given.series[0].time[-1] - given.series[0].time[0], 6) or 1.0, 1e-3, library.known
    )


def _write_proposal(
    file: Path, motion: Motion | None, sought: list[Parameter], present: np.ndarray, library: Library, fmu: Path
) -> dict[str, Any] | None:
    """Writes the scene of a motion, if there is one; how to run it, and what it tells."""
    if motion is None:
        return None
    told = motion.told(present)
    text = (
        f"A motion that would tell {scenes.series([sought[k].name for k in told])}: motors on sines of {motion.amplitude:g} rad and "
        f"{motion.frequency:g} Hz, about the posture in which it begins."
    )
    write_scene(file, text, motion.values, SECONDS, 1e-3, library.known, motion.signals())
    command = ["fivebar", "twin", "--scene", str(file), "--seconds", f"{SECONDS + 1:g}"]
    if not fmu.samefile(shipped.unit()):
        command += ["--fmu", str(fmu)]
    return {
        "scene": str(file),
        "command": shlex.join(command),
        "tells": {sought[k].name: float(sought[k].bar(interval(float(motion.sigma[k])))[0]) for k in told},
    }


def _report(
    result: Result,
    given: data.Data,
    source: str,
    options: Options,
    seconds: float,
    proposal: dict[str, Any] | None,
    impossible: list[str],
) -> dict[str, Any]:
    fit, judgement = result.fit, result.judgement
    unknowns = {}
    for k, p in enumerate(result.sought):
        members = p.members or (p.name,)
        bars, bounds = p.bar(interval(float(judgement.sigma[k]))), p.bar(interval(float(judgement.bound[k])))
        unknowns[p.name] = {
            "identified": judgement.identified[k],
            "unit": p.unit,
            "scene": dict(zip(members, p.base, strict=True)),
            "value": dict(zip(members, p.value(float(fit.x[k])), strict=True)) if judgement.identified[k] else None,
            "bar95": dict(zip(members, bars, strict=True)) if judgement.identified[k] else None,
            "bound95": dict(zip(members, bounds, strict=True)) if judgement.identified[k] else None,
            "derivative_error": float(judgement.doubt[k]),
        }
    return {
        "file": str(options.file),
        "refused": result.wrong or None,
        "warning": result.odd or None,
        "begins_from": source,
        "samples": sum(len(series) for series in given.series),
        "series": len(given.series),
        "period": given.period,
        "notes": given.notes,
        "outliers": fit.outliers,
        "residuals_rad": {"before": fit.rms_before, "encoder": fit.sigma.tolist()},
        "samples_as_one": judgement.together.time_scale,
        "unknowns": unknowns,
        "correlations": {p.name: judgement.correlation[k].tolist() for k, p in enumerate(result.sought)},
        "not_identified": judgement.not_identified(result.sought),
        "impossible": impossible,
        "proposal": proposal,
        "cpu_seconds": seconds,
        "runs": fit.machine.runs,
    }


def _print(result: Result, report: dict[str, Any], files: list[Path]) -> None:
    judgement = result.judgement
    if result.wrong or result.odd:
        print(result.wrong or result.odd)
    print(
        f"{report['samples']} samples in {report['series']} series, every {1e3 * report['period']:.3g} ms; begun from {report['begins_from']}"
    )
    for note in report["notes"]:
        print(f"  {note}")
    sigma = ", ".join(f"{1e3 * value:.3g}" for value in report["residuals_rad"]["encoder"])
    print(f"residuals {sigma} mrad (encoders 1, 2), {report['outliers']} outliers left out", end="")
    scale = judgement.together.time_scale
    print("; they are white" if scale == 1.0 else f"; {scale:.0f} of them count as one")
    print(f"\n  {'':28} {'scene':>12} {'found':>14} {'± 95 %':>11} {'bound 95 %':>11}")
    for k, p in enumerate(result.sought):
        if judgement.identified[k]:
            bar, bound = (p.bar(interval(float(sigma)))[0] for sigma in (judgement.sigma[k], judgement.bound[k]))
            print(
                f"  {p.name:28} {p.base[0]:12.6g} {p.value(float(result.fit.x[k]))[0]:14.7g} {bar:11.2g} {bound:11.2g}  {p.unit}"
            )
        else:
            print(f"  {p.name:28} {p.base[0]:12.6g} {'not identified':>14}")
    for sentence in report["impossible"]:
        print(f"warning: {sentence}")
    for sentence in report["not_identified"]:
        print(f"not identified: {sentence}")
    worst = max(range(len(result.sought)), key=lambda k: judgement.doubt[k] if judgement.identified[k] else 0.0)
    print(
        f"derivatives: twice the step differs by {judgement.doubt[worst]:.1g} of the column at most ({result.sought[worst].name})"
    )
    if not all(judgement.identified) and not result.wrong:
        _say_proposal(report["proposal"])
    if not any(judgement.identified):
        print("calibrated.json is not written: nothing is identified")
    print(f"{report['runs']} runs, {report['cpu_seconds']:.1f} s of CPU; written: {', '.join(map(str, files))}")


def _say_proposal(proposal: dict[str, Any] | None) -> None:
    """How to learn more."""
    if proposal is None:
        print("no motion of those that were tried would tell more")
        return
    told = ", ".join(f"{name} to ±{bar:.2g}" for name, bar in proposal["tells"].items())
    print(
        f"a motion that would tell {told}: {proposal['scene']}\nrun it, and calibrate the record that it leaves:\n  {proposal['command']}"
    )
