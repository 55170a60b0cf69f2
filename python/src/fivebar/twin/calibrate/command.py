"""`fivebar calibrate FILE`: parameters of the machine from samples of its encoders."""

import json
import shlex
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fivebar import shipped
from fivebar.library import Library
from fivebar.scene import content, write_content
from fivebar.twin.calibrate import scenes
from fivebar.twin.calibrate.calibration import SMALL, Problem, prepare
from fivebar.twin.calibrate.fit import TimeLimitExceeded
from fivebar.twin.calibrate.identify import interval
from fivebar.twin.calibrate.motion import Between
from fivebar.twin.calibrate.propose import SECONDS, propose


@dataclass(frozen=True)
class Options:
    """Options of a calibration: the record, the unknowns, the fit."""

    file: Path
    """A record (Parquet or a folder of parts), or a table (CSV or Parquet)."""

    parameters: tuple[str, ...]
    """Unknowns by name; none means `USUAL`."""

    scene: str | Path | None
    """Scene with the assumed parameters of the machine; by default the record's scene."""

    begin: float
    """Begin of the used part, s after the first sample."""

    seconds: float
    """Length of the used part, s."""

    longest: float
    """Length, s, at which longer series are cut."""

    commands: Between
    """Course of the commands between samples."""

    patience: float
    """CPU time, s, after which a fit is abandoned."""

    unit: str
    """Name of the machine, if the record has several."""

    proposal: bool
    """Whether to search for a motion that identifies the remaining unknowns."""

    fmu: Path
    out: Path


def run(options: Options) -> int:
    """0 if at least one unknown is identified, 1 if none is or the record is not of this machine."""
    begun = time.process_time()
    library = Library(options.fmu)
    try:
        problem = prepare(
            options.file, options.scene, options.parameters, library, options.begin, options.seconds, options.unit
        )
        options.out.mkdir(parents=True, exist_ok=True)
        # Files of an earlier record could be mistaken for files of this one.
        calibrated, proposed = (options.out / name for name in ("calibrated.json", "proposal.json"))
        for file in (calibrated, proposed):
            if options.scene is None or Path(options.scene).resolve() != file.resolve():
                file.unlink(missing_ok=True)
        try:
            found = problem.solve(options.commands, options.longest, options.patience, _show)
        except TimeLimitExceeded:
            if options.proposal:
                unknown = np.full(len(problem.sought), np.inf)
                _say_proposal(_write_proposal(proposed, problem, np.full(2, SMALL), unknown, options.fmu))
            raise
        proposal, solution = None, found.solution
        if solution.refused() and not solution.wrong and options.proposal:
            noise = np.minimum(solution.fit.sigma, SMALL)
            proposal = _write_proposal(proposed, problem, noise, solution.judgement.sigma, options.fmu)
    finally:
        library.close()
    seconds = time.process_time() - begun
    report = {"file": str(options.file), **found.figures(), "proposal": proposal, "cpu_seconds": seconds}
    written = [options.out / "calibration.json"]
    written[0].write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    if found.values:
        write_content(calibrated, found.content())
        written.insert(0, calibrated)
    written += found.pictures(options.out)
    print(found.summary())
    if solution.refused() and not solution.wrong:
        _say_proposal(proposal)
    if not found.values:
        print("calibrated.json is not written: nothing is identified")
    print(f"{report['runs']} runs, {seconds:.1f} s of CPU; written: {', '.join(map(str, written))}")
    return 0 if found.values else 1


def _show(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _write_proposal(
    file: Path, problem: Problem, noise: np.ndarray, present: np.ndarray, fmu: Path
) -> dict[str, Any] | None:
    """Writes the scene of a motion that identifies more, if there is one; returns its command and the unknowns that it identifies."""
    library, sought = problem.library, problem.sought
    motion = propose(library, problem.assumed.machine, sought, problem.taken, noise, present)
    if motion is None:
        return None
    improved = motion.improved(present)
    text = (
        f"A motion to identify {scenes.series([sought[k].name for k in improved])}: motors on sines of {motion.amplitude:g} rad and "
        f"{motion.frequency:g} Hz, about the posture in which it begins."
    )
    write_content(file, content(text, motion.values, SECONDS, 1e-3, library.known, motion.signals()))
    command = ["fivebar", "twin", "--scene", str(file), "--seconds", f"{SECONDS + 1:g}"]
    if not fmu.samefile(shipped.unit()):
        command += ["--fmu", str(fmu)]
    return {
        "scene": str(file),
        "command": shlex.join(command),
        "tells": {sought[k].name: float(sought[k].bar(interval(float(motion.sigma[k])))[0]) for k in improved},
    }


def _say_proposal(proposal: dict[str, Any] | None) -> None:
    """Lines on the proposed motion."""
    if proposal is None:
        print("none of the tried motions would identify more")
        return
    gains = ", ".join(f"{name} to ±{bar:.2g}" for name, bar in proposal["tells"].items())
    print(
        f"a motion to identify {gains}: {proposal['scene']}\nrun it, then calibrate its record:\n  {proposal['command']}"
    )
