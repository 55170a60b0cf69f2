"""`--guess SCENE`: proposes a map from the data of a recording, and reports ambiguities."""

from dataclasses import replace

import numpy as np

from fivebar import scene as scenes
from fivebar.errors import FiveBarError
from fivebar.scene import Scene
from fivebar.twin import redundancy
from fivebar.twin.importing.maps import PASSIVE, Entry, Map
from fivebar.twin.messages import MEASURED
from fivebar.twin.recording import Recording
from fivebar.twin.redundancy import ASSIGNMENTS, FLOOR, TURN, Verdict


def lines(found: Recording, used: Map, given: str) -> list[str]:
    """Lines about the map of a recording of the scene's machine, with a proposed map."""
    if missing := [name for name in MEASURED if name not in used.entries]:
        raise FiveBarError(f"the map has no {missing[0]}; a guess needs both encoders")
    if not np.any(np.all(np.isfinite([found.columns[name] for name in MEASURED]), axis=0)):
        raise FiveBarError("no row has a reading of both encoders; a guess needs both")
    scene = scenes.read(given)
    relative = [name in used.entries and used.entries[name].relative for name in PASSIVE]
    verdict = redundancy.weigh(found, scene, (relative[0], relative[1]))
    told = [f"by the scene {scene.name}, assuming its assembly is right:"]
    for each in verdict.evidence:
        order = sorted(range(len(each.fits)), key=lambda k: float(f"{each.fits[k].misfit:.3g}"))
        best, next_ = (f"{ASSIGNMENTS[k].words()} ({each.fits[k].misfit:.3g} {each.unit})" for k in order[:2])
        left_out = (
            "" if each.is_believed else "; this is left out: is the machine the scene's, and moved by its drives?"
        )
        told.append(f"  {each.name}: {best} fits best, then {next_}{left_out}")
    if others := [ASSIGNMENTS[k].words() for k in verdict.possible[1:]]:
        told.append(f"  not distinguishable from {verdict.chosen.words()}: {'; '.join(others)}")
    told += [f"  {sentence}" for sentence in _zeros(verdict)]
    proposed = propose(found, used, scene, verdict)
    if proposed == used:
        return [*told, "the map may stay as it is"]
    return [*told, "proposed map:", proposed.text()]


def propose(found: Recording, used: Map, scene: Scene, verdict: Verdict) -> Map:
    """The map with the columns, signs, zeros and turns identified from the recording."""
    chosen = verdict.chosen
    sources = MEASURED[::-1] if chosen.exchanged else MEASURED
    entries: dict[str, Entry] = {}
    for i, (name, source, sign) in enumerate(zip(MEASURED, sources, chosen.signs, strict=True)):
        column = found.columns[source]
        # The zero of the map stays unless the change is significant.
        zero = float(verdict.zeros[i]) if abs(verdict.zeros[i]) > 3 * verdict.sigma[i] else 0.0
        first = sign * float(column[np.isfinite(column)][0]) + zero
        turns = round((float(scene[f"init.theta[{i + 1}]"]) - first) / TURN)
        entries[name] = _changed(used.entries[source], sign, zero + TURN * turns)
    for name, leg in zip(PASSIVE, verdict.passive or (), strict=False):
        entries[name] = _changed(
            used.entries[PASSIVE[leg.column]], leg.sign, leg.zero if abs(leg.zero) > 2 * FLOOR else 0.0
        )
    return used.exchanged(entries)


def _changed(entry: Entry, sign: int, zero: float) -> Entry:
    """The entry for sign x value + zero."""
    return replace(entry, sign=sign * entry.sign, offset=sign * entry.offset + zero)


def _zeros(verdict: Verdict) -> list[str]:
    """Lines about the zeros."""
    found = []
    for name, zero, sigma in zip(MEASURED, verdict.zeros, verdict.sigma, strict=True):
        if np.isfinite(sigma):
            found.append(
                f"{name}: zero {zero:.4f} ± {sigma:.1g} rad relative to the map, for length errors of estimator.sigma0.length"
            )
        else:
            found.append(f"{name}: its zero is not identified")
    return found
