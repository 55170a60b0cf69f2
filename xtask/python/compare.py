"""Compares two builds of the library: every scene by every method, in bits.

python compare.py --before target/compare/26ed735/target/fmu/FiveBar.fmu --after target/fmu/FiveBar.fmu --scenes scenes
"""

import argparse
import io
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from fivebar.drive import Progress, Run, StartRefused, drive
from fivebar.library import Library
from fivebar.scene import Scene, Variant, read
from fivebar.summary import tip_distance
from fivebar.variables import Values, Variables

LONGEST = 2.0
"""Largest compared duration of a scene, s."""

COARSEST = 0.01
"""Communication step, s, of scenes with shorter steps. Reading more often would show little more, because differences persist."""

EARLY = 0.5
"""Duration, s, without growth of round-off."""

ROUND_OFF = 1e-12
"""Largest difference of the tips until then, m."""

NUDGES = (1e-14, -1e-14)
"""Changes of the start angle init.theta[1], rad; they show whether a run amplifies round-off by itself."""


class Verdict(StrEnum):
    """Kind of a difference."""

    SAME = "same bits"
    ROUND_OFF = "round-off"
    CHAOTIC = "chaotic"
    BROKEN = "NOT round-off"


@dataclass(frozen=True)
class Difference:
    """Difference between two runs of a scene: first time at which any output differs, largest distance of the tips in the first EARLY
    seconds, counters and other integers that differ at the end, and how the ends differ."""

    since: float | None
    tip: float
    counters: tuple[str, ...]
    ends: str | None

    @property
    def small(self) -> bool:
        """Whether the difference may be round-off."""
        return self.tip <= ROUND_OFF and self.ends is None

    def __str__(self) -> str:
        words = []
        if self.since is not None:
            words.append(f"differ from {self.since:g} s on, tips by {self.tip:.1e} m up to {EARLY:g} s")
        if self.counters:
            words.append(f"counted otherwise: {', '.join(self.counters)}")
        return "; ".join(words + [self.ends] if self.ends else words)


def main(arguments: list[str] | None = None) -> int:
    """Compares all scenes; exit code 0: at most round-off differs, 1: something else does."""
    parser = argparse.ArgumentParser(description="Compares two builds of the library, every scene by every method.")
    parser.add_argument("--before", type=Path, required=True, help="the .fmu taken as correct")
    parser.add_argument("--after", type=Path, required=True, help="the .fmu to judge")
    parser.add_argument("--scenes", type=Path, required=True, help="the folder scenes/")
    options = parser.parse_args(arguments)
    begin = time.perf_counter()
    before, after = Library(options.before), Library(options.after)
    verdicts: Counter[Verdict] = Counter()
    for path in sorted(options.scenes.glob("*.json")):
        scene = read(path, after.known).coarser(COARSEST, LONGEST)
        unknown = {*scene.variants[0].values, *scene.signals} - set(before.known)
        if unknown:
            print(f"{scene.name:20} left out: the old build does not know {', '.join(sorted(unknown))}")
            continue
        for variant in _by_every_method(before.known, after.known, scene.variants[0].values):
            judged, words = _judge(before, after, scene, variant)
            print(f"{scene.name:20} {variant.label:18} {words}", flush=True)
            verdicts[judged] += 1
    print(f"\n{_total(verdicts)} ({time.perf_counter() - begin:.0f} s)")
    return 1 if verdicts[Verdict.BROKEN] else 0


def difference(before: Run, after: Run) -> Difference:
    """Compares two runs of the same scene in the outputs that both have."""
    names = [name for name in before.columns if name in after.columns]
    rows = min(len(before.time), len(after.time))
    apart = np.zeros(rows, dtype=bool)
    counters = []
    for name in names:
        old, new = (np.ascontiguousarray(run[name][:rows]) for run in (before, after))
        # Compared as integers of eight bytes, so that NaN equals itself and 0 differs from -0.
        unequal = old.view(np.int64) != new.view(np.int64)
        apart |= unequal
        if old.dtype.kind == "i" and rows and unequal[-1]:
            counters.append(name)
    since = float(before.time[np.argmax(apart)]) if apart.any() else None
    early = tip_distance(before, after)[before.time[:rows] <= EARLY] if rows else np.zeros(1)
    ends = [_end(run) for run in (before, after)]
    return Difference(
        since, float(np.max(early)), tuple(counters), " but then ".join(ends) if ends[0] != ends[1] else None
    )


def verdict(found: Difference, nudged: list[Difference]) -> Verdict:
    """Kind of the difference `found` between two builds. `nudged` are differences of the old build from itself at slightly changed starts."""
    if found.since is None and found.ends is None:
        return Verdict.SAME
    if found.small:
        return Verdict.ROUND_OFF
    return Verdict.BROKEN if all(other.small for other in nudged) else Verdict.CHAOTIC


def _judge(before: Library, after: Library, scene: Scene, variant: Variant) -> tuple[Verdict, str]:
    """The verdict and its text; the changed starts run only if needed."""
    old = _run(before, scene, variant)
    found = difference(old, _run(after, scene, variant))
    judged = verdict(found, [])
    if judged is Verdict.SAME:
        return judged, str(judged)
    if judged is Verdict.ROUND_OFF:
        return judged, f"{found} ({judged})"
    nudged = [difference(old, _run(before, scene, other)) for other in _nudged(variant, before.known)]
    judged = verdict(found, nudged)
    moved = max(other.tip for other in nudged)
    return judged, f"{found} ({judged}: {NUDGES[0]:g} rad at the start move the old build's tip by {moved:.1e} m)"


def _nudged(variant: Variant, known: Variables) -> Iterator[Variant]:
    angle = "init.theta[1]"
    for nudge in NUDGES:
        yield replace(variant, values=variant.values | {angle: variant.values.get(angle, known.start[angle]) + nudge})


def _run(build: Library, scene: Scene, variant: Variant) -> Run:
    """One run; if the start is refused, a run without rows."""
    try:
        return drive(build, scene, variant, Progress(scene.name, scene.stop_time, io.StringIO()))
    except StartRefused as sentence:
        nothing = {name: np.empty(0) for name in ("time", "tip.x", "tip.y")}
        return Run(variant.label, scene.stop_time, scene.step_size, {}, nothing, {}, failure=str(sentence))


def _by_every_method(before: Variables, after: Variables, values: Values) -> Iterator[Variant]:
    """A scene by each method that both builds have and that accepts it; `i3alp` also with a fixed step."""
    sticks = 2 in (values.get("friction.law"), values.get("contact.law"))
    old, new = (known["solver.method"].items for known in (before, after))
    for name, number in old.items():
        if name not in new:
            continue
        if new[name] != number:
            raise SystemExit(f"method {name} has the number {number} in one build and {new[name]} in the other.")
        if sticks and name not in ("i3alp", "dop853", "automatic"):
            continue
        yield Variant(name, values | {"solver.method": number, "solver.adaptive": True})
        if name == "i3alp" and not sticks:
            yield Variant("i3alp, fixed step", values | {"solver.method": number, "solver.adaptive": False})


def _end(run: Run) -> str:
    if run.failure is None:
        return "a run to the end"
    return f"an end at {run.time[-1]:g} s: {run.failure}" if len(run.time) else f"no start: {run.failure}"


def _total(verdicts: Counter[Verdict]) -> str:
    return (
        f"{verdicts[Verdict.SAME]} of {verdicts.total()} runs have the same bits, "
        f"{verdicts[Verdict.ROUND_OFF]} differ by round-off, "
        f"{verdicts[Verdict.CHAOTIC]} are chaotic before {EARLY:g} s, {verdicts[Verdict.BROKEN]} differ by more than round-off"
    )


if __name__ == "__main__":
    sys.exit(main())
