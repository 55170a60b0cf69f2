"""`fivebar check SCENE FILE`: the first questions about a record of a machine, each with its answer and with the fix for map or scene.

The judgements are those of the import: units from `recording`, rates and encoders from `quality`, signs, exchanges, zeros and reach from
`redundancy` by way of `guess`, and length and motion from `calibrate.data`.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np

from fivebar import scene as scenes
from fivebar.errors import FiveBarError
from fivebar.kinematics import Machine
from fivebar.plain import plain
from fivebar.scene import Scene
from fivebar.scene_file import OFFSETS
from fivebar.twin import config as configuration
from fivebar.twin import record, redundancy, setup
from fivebar.twin.calibrate import data
from fivebar.twin.errors import TwinError
from fivebar.twin.importing import assemble, guess, maps, quality
from fivebar.twin.importing.maps import COUNTS, LENGTHS, Entry, Map
from fivebar.twin.importing.quality import EVEN, Quality
from fivebar.twin.messages import MEASURED, SERVOS, TRACKED
from fivebar.twin.recording import TIME, Recording, WrongUnit
from fivebar.twin.redundancy import CLOSES, MOVES, TURN, Verdict

State = Literal["ok", "fix", "?"]

FAR: Final = 3.0
"""Tip distances beyond this multiple of the reach are in another unit: a tracker's origin is within a few links of the machine."""

AWAY: Final = 0.2
"""Distance of the first sample from the scene's start that is worth a question, rad."""

OTHER: Final = 2.0
"""Ratio of an encoder's error to the error of the scene from which on the twin's bands would be wrong."""

REDUNDANT: Final = (
    "to see signs, exchanges and zeros, record one of passive.theta[1..2], tip.x and tip.y, servo.theta[1..2] that the machine follows, "
    "or tau[1..2] of slow motions under gravity"
)


class Finding(NamedTuple):
    """An answer."""

    state: State
    question: str
    sentence: str


@dataclass
class Source:
    """The record that is checked."""

    recording: Recording
    used: Map
    """The map of a file; the names of the fields if a program publishes them."""

    is_live: bool
    """Whether a program publishes the samples, so that there is no map."""

    findings: list[Finding]


@dataclass
class Report:
    """Answers and fixes."""

    findings: list[Finding]
    map_text: str = ""
    """The map to use; "" if there is none or it may stay."""

    publish: list[str] = field(default_factory=list)
    """Advice for the publishing program."""

    scene: dict[str, float] = field(default_factory=dict)
    """Values for the scene, by name."""

    is_unique: bool = True
    """Whether no other signs and order of the encoders fit."""

    @property
    def is_fine(self) -> bool:
        return all(each.state != "fix" for each in self.findings)

    def lines(self) -> list[str]:
        """The report as text."""
        found = [f"  {each.state:3}  {each.question:9} {each.sentence}" for each in self.findings]
        one_of = "" if self.is_unique else ", one of several that fit"
        if self.map_text:
            found += ["", f"the map{one_of}:", self.map_text]
        if self.publish:
            found += ["", f"publish{one_of}:", *(f"  {line}" for line in self.publish)]
        if self.scene:
            found += ["", "for the scene:"]
            found += [f"  {json.dumps(name)}: {value:.6g}," for name, value in self.scene.items()]
        return found


def run(scene: str, source: Source) -> int:
    """Prints the report; returns 1 if something is to be fixed."""
    given = source.recording
    read = scenes.read(scene)
    report = judge(read, source)
    print(f"{given.source}, taken as the machine of {read.name}: {len(given.time)} samples, {given.time[-1]:.4g} s")
    print("\n".join(report.lines()))
    return 0 if report.is_fine else 1


def of_file(file: Path, map_file: Path | None, unit: str, scene: str) -> Source:
    """The record in a file. Units that are plainly wrong are put right, with a finding."""
    if record.is_record(file) and record.is_of_twin(file):
        if map_file:
            raise FiveBarError(f"{file} is a record of `fivebar twin`, and --map is {map_file}: it needs none")
        return of_recording(data.of_record(file, unit))
    machine = Machine.from_scene(scenes.read(scene))
    used = maps.read(map_file) if map_file else maps.Map()
    used = used if used.entries else assemble.named(file, used)
    findings = []
    while True:
        try:
            found, used = assemble.recorded([file], used)
            if doubt := tip_unit(found, machine):
                raise doubt
        except WrongUnit as doubt:
            entry = used.time if doubt.name == TIME else used.entries[doubt.name]
            if doubt.unit == COUNTS:
                keys = f'"unit": "{COUNTS}", "steps": N, with N counts in a turn of the motor axis (docs/recordings.md)'
                raise FiveBarError(f"{doubt} For {doubt.name}, the map then needs {keys}") from None
            if entry.unit:
                raise
            findings.append(Finding("fix", "units", f"{doubt.question} Taken as {doubt.unit}."))
            used = used.in_unit(doubt.name, doubt.unit)
            # Both columns of a tip have the same unit.
            if doubt.name == TRACKED[0]:
                used = used.in_unit(TRACKED[1], doubt.unit)
        else:
            return Source(found, used, False, findings)


def of_recording(given: Recording) -> Source:
    """The record of messages, without a map."""
    columns = {name: column for name, column in given.columns.items() if np.isfinite(column).any()}
    return Source(given, Map(entries={name: Entry(name) for name in columns}), True, [])


def tip_unit(given: Recording, machine: Machine) -> WrongUnit | None:
    """The question about the unit of the tip, if another unit than m fits the machine."""
    if not all(name in given.columns for name in TRACKED):
        return None
    far = float(np.nanmax(np.hypot(*(given.columns[name] for name in TRACKED)), initial=0.0))
    reach = machine.distance + max(machine.lengths[0] + machine.lengths[1], machine.lengths[2] + machine.lengths[3])
    fitting = [unit for unit, factor in LENGTHS.items() if far * factor <= FAR * reach]
    if not fitting or fitting[0] == "m":
        return None
    question = (
        f"the tip is up to {far:.4g} m from the origin, but the machine reaches {reach:.4g} m: are these {fitting[0]}?"
    )
    return WrongUnit(given.source, question, TRACKED[0], fitting[0])


def judge(scene: Scene, source: Source) -> Report:
    """The report on a record."""
    given, used = source.recording, source.used
    report = Report([*source.findings])
    measured = quality.measure(given)
    report.findings += [
        *_units(source, scene),
        *_clock(given),
        *_rates(measured),
        *_encoders(given),
        *_drives(given, scene),
    ]
    if all(name in used.entries and np.isfinite(given.columns[name]).any() for name in MEASURED):
        verdict = guess.weighed(given, used, scene)
        report.is_unique = len(verdict.possible) == 1
        report.findings += [*_turns(given), *_assignment(verdict), *_zeros(verdict)]
        report.findings += _start(given, scene, verdict, report)
        _propose(source, scene, verdict, report)
    for each in measured:
        _estimator(each, scene, report)
    return report


def _units(source: Source, scene: Scene) -> Iterator[Finding]:
    ranges = [
        f"{name} {np.nanmin(column):.4g} to {np.nanmax(column):.4g}"
        for name, column in source.recording.columns.items()
        if name in MEASURED and np.isfinite(column).any()
    ]
    if source.is_live and (doubt := tip_unit(source.recording, Machine.from_scene(scene))):
        yield Finding("fix", "units", doubt.question)
    if not source.findings:
        yield Finding("ok", "units", f"{' rad, '.join(ranges)} rad; times in s")


def _clock(given: Recording) -> Iterator[Finding]:
    for note in given.notes:
        yield Finding("fix" if note == given.coarse else "ok", "record", note)
    if given.begins:
        at = f"{given.time[given.begins[0]]:.3f} s"
        yield Finding(
            "?",
            "clock",
            f"falls back {len(given.begins)} times, first at {at}: several series, a restart, or a counter that overflows?",
        )
    else:
        yield Finding("ok", "clock", "never falls back")


def _rates(measured: list[Quality]) -> Iterator[Finding]:
    for each in measured:
        is_broken = any(gap.steps > data.GAP for gap in each.gaps)
        yield Finding("fix" if is_broken else "ok", "rate", each.sentence())
        if each.uneven > EVEN:
            in_ = " and ".join(f"{1e3 * period:.3g}" for period in each.periods)
            yield Finding(
                "fix",
                "jitter",
                f"{each.name} is {1e3 * each.jitter:.3g} ms uneven in {in_} ms: stamp a sample where the encoder is read, not where it arrives",
            )


def _encoders(given: Recording) -> Iterator[Finding]:
    try:
        found = data.split(given)
        if found.left_out:
            yield Finding("fix", "record", found.left_out)
        data.check(found)
    except TwinError as error:
        yield Finding("fix", "record", str(error))
    for i, (name, other) in enumerate(zip(MEASURED, MEASURED[::-1], strict=True)):
        if name not in given.columns or not np.isfinite(given.columns[name]).any():
            yield Finding("fix", "encoders", f"{name} has no reading")
            continue
        column = given.columns[name]
        moved = float(np.nanmax(column) - np.nanmin(column))
        still = quality.find_still(given, i) if other in given.columns else None
        if still and still.other > MOVES and (still.is_all or still.commanded > MOVES):
            stands = f"{name} stands at {still.reading:.4g} rad from {still.begin:.3f} to {still.end:.3f} s"
            while_ = (
                f"{SERVOS[i]} moves by {still.commanded:.3g} rad"
                if still.commanded > MOVES
                else f"{other} moves by {still.other:.3g} rad"
            )
            yield Finding("fix", "encoders", f"{stands} while {while_}: is it connected and powered?")
        elif moved <= MOVES:
            yield Finding(
                "?", "encoders", f"{name} moves by {moved:.3g} rad: turn the axis by more than {MOVES:g} rad to see it"
            )
        else:
            yield Finding("ok", "encoders", f"{name} moves by {moved:.3g} rad")


def _drives(given: Recording, scene: Scene) -> Iterator[Finding]:
    try:
        doubt = data.unled(data.split(given), {**scene.variables.start, **scene.values})
    except TwinError:
        # `_encoders` reports it.
        return
    if doubt:
        yield Finding("?", "drives", doubt)


def _turns(given: Recording) -> Iterator[Finding]:
    periods = given.periods
    for name in MEASURED:
        rows = np.flatnonzero(np.isfinite(given.columns[name]))
        steps, apart = np.diff(given.columns[name][rows]), np.diff(given.time[rows])
        jumps = np.flatnonzero((np.abs(steps) > np.pi) & (apart <= quality.LOST * periods[rows[1:]]))
        odd = jumps[np.abs(steps[jumps] - TURN * np.round(steps[jumps] / TURN)) > 0.5]
        if len(odd):
            at = given.time[rows[odd[0] + 1]]
            yield Finding(
                "fix",
                "turns",
                f"{name} jumps by {steps[odd[0]]:.4g} rad at {at:.3f} s, which is no whole turn: does its counter overflow or restart?",
            )
        elif len(jumps):
            yield Finding("ok", "turns", f"{name} jumps by whole turns {len(jumps)} times; all commands unwrap them")


def _assignment(verdict: Verdict) -> Iterator[Finding]:
    for each in verdict.evidence:
        yield Finding("ok" if each.is_believed else "?", "signs", f"by {guess.evidence(each)}")
    if verdict.chosen != redundancy.ASSIGNMENTS[0]:
        # If several assignments fit, the chosen one is a guess.
        yield Finding("fix" if len(verdict.possible) == 1 else "?", "signs", verdict.chosen.words())
    if others := guess.alike(verdict):
        yield Finding("?", "signs", others)
    if verdict.beyond > 1 - CLOSES:
        yield Finding(
            "fix",
            "reach",
            f"{plain(100 * verdict.beyond)} % of the samples are beyond the machine's reach: are lengths, zeros and signs right?",
        )
    else:
        yield Finding("ok", "reach", "the machine reaches the samples")


def _zeros(verdict: Verdict) -> Iterator[Finding]:
    for i, sentence in enumerate(guess.zeros(verdict)):
        yield Finding(
            "fix" if guess.change(verdict, i) else "ok" if np.isfinite(verdict.sigma[i]) else "?", "zeros", sentence
        )
    if not np.isfinite(verdict.sigma).all():
        yield Finding("?", "zeros", REDUNDANT)


def _start(given: Recording, scene: Scene, verdict: Verdict, report: Report) -> Iterator[Finding]:
    """Compares the first sample with the start of the scene."""
    order = (1, 0) if verdict.chosen.exchanged else (0, 1)
    for i, k in enumerate(order):
        column = given.columns[MEASURED[k]] - scene.offsets.get(OFFSETS[k], 0.0)
        first = verdict.chosen.signs[i] * float(column[np.isfinite(column)][0]) + float(verdict.zeros[i])
        name = f"init.theta[{i + 1}]"
        start = float(scene[name])
        apart = first - start - TURN * round((first - start) / TURN)
        if abs(apart) <= AWAY:
            continue
        if np.isfinite(verdict.sigma[i]):
            report.scene[name] = start + apart
            yield Finding(
                "fix",
                "start",
                f"the record begins at {start + apart:.4g} rad, and the scene at {name} = {start:.4g} rad",
            )
        else:
            yield Finding(
                "?",
                "start",
                f"the record begins {abs(apart):.3g} rad {'beyond' if apart > 0 else 'before'} {name} = {start:.4g} rad: if the machine stood there, "
                f"the encoder has this zero, {json.dumps(OFFSETS[k])}: {apart + scene.offsets.get(OFFSETS[k], 0.0):.4g}; else the scene needs another start",
            )


def _propose(source: Source, scene: Scene, verdict: Verdict, report: Report) -> None:
    """Adds the map; for a live machine, adds advice for the publishing program and mounting angles for the scene."""
    proposed = guess.propose(source.recording, source.used, scene, verdict)
    if not source.is_live:
        if proposed != source.used or source.findings:
            report.map_text = proposed.text()
        return
    for i, name in enumerate(MEASURED):
        new, old = proposed.entries[name], source.used.entries[name]
        if (new.column, new.sign) != (old.column, old.sign):
            report.publish.append(f"as {name}: {'-' if new.sign < 0 else ''}{new.column}")
        # The mounting angle is reading minus true angle; the twin finds the turn itself.
        apart = new.offset - TURN * round(new.offset / TURN)
        if apart:
            report.scene[OFFSETS[i]] = scene.offsets.get(OFFSETS[i], 0.0) - apart


def _estimator(measured: Quality, scene: Scene, report: Report) -> None:
    """Adds the lines about an encoder whose error differs from the scene's."""
    i = measured.name[-3:]
    known = setup.encoders(configuration.Machine(), scene.values)
    quantum, sigma = known[f"estimator.quantum{i}"], known[f"estimator.sigma{i}"]
    error, assumed = np.hypot(measured.noise, measured.step / 12**0.5), np.hypot(sigma, quantum / 12**0.5)
    # Without steps, a small error may be an encoder that stands still, or a simulated one.
    if error > OTHER * assumed or (measured.step and error * OTHER < assumed):
        report.scene |= measured.settings()
        report.findings.append(
            Finding(
                "fix",
                "noise",
                f"{measured.name} has an error of {plain(1e3 * error)} mrad by steps and noise, but the twin assumes {plain(1e3 * assumed)} mrad",
            )
        )
