"""Proposes a map from the data of a recording, and reports ambiguities, for `fivebar import --guess` and `fivebar check`."""

from dataclasses import replace
from typing import Final

import numpy as np

from fivebar import scene as scenes
from fivebar.errors import FiveBarError
from fivebar.scene import Scene
from fivebar.scene_file import OFFSETS
from fivebar.twin import redundancy
from fivebar.twin.importing.maps import PASSIVE, Entry, Map
from fivebar.twin.messages import MEASURED
from fivebar.twin.recording import Recording
from fivebar.twin.redundancy import ASSIGNMENTS, FLOOR, TURN, Evidence, Verdict
from fivebar.twin.scene import OFFSET_OF

SIGNIFICANT: Final = 3.0
"""Standard deviations by which a zero differs from the zero of the map before the map changes."""


def lines(found: Recording, used: Map, given: str) -> list[str]:
    """Lines about the map of a recording of the scene's machine, with a proposed map."""
    scene = scenes.read(given)
    verdict = weighed(found, used, scene)
    sentences = [f"by the scene {scene.name}, assuming its assembly is right:"]
    sentences += [f"  {evidence(each)}" for each in verdict.evidence]
    if others := alike(verdict):
        sentences.append(f"  {others}")
    sentences += [f"  {sentence}" for sentence in zeros(verdict)]
    proposed = propose(found, used, scene, verdict)
    if proposed == used:
        return [*sentences, "the map may stay as it is"]
    return [*sentences, "proposed map:", proposed.text()]


def weighed(found: Recording, used: Map, scene: Scene) -> Verdict:
    """Conclusions from a recording of the scene's machine. Raises FiveBarError without readings of both encoders."""
    if missing := [name for name in MEASURED if name not in used.entries]:
        raise FiveBarError(f"the map has no {missing[0]}; a guess needs both encoders")
    if not np.any(np.all(np.isfinite([found.columns[name] for name in MEASURED]), axis=0)):
        raise FiveBarError("no row has a reading of both encoders; a guess needs both")
    relative = [name in used.entries and used.entries[name].relative for name in PASSIVE]
    offsets = {name: scene.offsets.get(key, 0.0) for name, key in OFFSET_OF.items()}
    # A relative angle was counted from the encoder's reading.
    offsets |= {
        name: offsets[of] for name, of, is_relative in zip(PASSIVE, MEASURED, relative, strict=True) if is_relative
    }
    true = {name: column - offsets.get(name, 0.0) for name, column in found.columns.items()}
    return redundancy.weigh(replace(found, columns=true), scene, (relative[0], relative[1]))


def evidence(given: Evidence) -> str:
    """Sentence about the assignments that fit best."""
    order = sorted(range(len(given.fits)), key=lambda k: float(f"{given.fits[k].misfit:.3g}"))
    best, next_ = (f"{ASSIGNMENTS[k].words()} ({given.fits[k].misfit:.3g} {given.unit})" for k in order[:2])
    left_out = "" if given.is_believed else "; this is left out: is the machine the scene's, and moved by its drives?"
    return f"{given.name}: {best} fits best, then {next_}{left_out}"


def alike(verdict: Verdict) -> str:
    """Sentence about the other possible assignments; "" without any."""
    others = [ASSIGNMENTS[k].words() for k in verdict.possible[1:]]
    return f"not distinguishable from {verdict.chosen.words()}: {'; '.join(others)}" if others else ""


def zeros(verdict: Verdict) -> list[str]:
    """Sentences about the zeros."""
    return [
        f"{name}: zero {zero:.4f} ± {sigma:.1g} rad relative to the map{', ' * bool(basis)}{basis}"
        if np.isfinite(sigma)
        else f"{name}: its zero is not identified"
        for name, zero, sigma, basis in zip(MEASURED, verdict.zeros, verdict.sigma, verdict.bases, strict=True)
    ]


def change(verdict: Verdict, i: int) -> float:
    """Zero to add to motor angle `i`, rad: 0 unless it is significant."""
    return float(verdict.zeros[i]) if abs(verdict.zeros[i]) > SIGNIFICANT * verdict.sigma[i] else 0.0


def propose(found: Recording, used: Map, scene: Scene, verdict: Verdict) -> Map:
    """The map with the columns, signs, zeros and turns identified from the recording."""
    chosen = verdict.chosen
    order = (1, 0) if chosen.exchanged else (0, 1)
    entries: dict[str, Entry] = {}
    for i, (name, k, sign) in enumerate(zip(MEASURED, order, chosen.signs, strict=True)):
        column = found.columns[MEASURED[k]]
        # The scene's mounting angles stay in the columns.
        own, other = (scene.offsets.get(OFFSETS[each], 0.0) for each in (i, k))
        zero = change(verdict, i) + own - sign * other
        first = sign * float(column[np.isfinite(column)][0]) + zero - own
        turns = round((float(scene[f"init.theta[{i + 1}]"]) - first) / TURN)
        entries[name] = _changed(used.entries[MEASURED[k]], sign, zero + TURN * turns)
    for name, leg in zip(PASSIVE, verdict.passive or (), strict=False):
        entries[name] = _changed(
            used.entries[PASSIVE[leg.column]], leg.sign, leg.zero if abs(leg.zero) > 2 * FLOOR else 0.0
        )
    return used.exchanged(entries)


def _changed(entry: Entry, sign: int, zero: float) -> Entry:
    """The entry that converts to sign x v + zero, if `entry` converts to v."""
    return replace(entry, sign=sign * entry.sign, offset=sign * entry.offset + zero)
