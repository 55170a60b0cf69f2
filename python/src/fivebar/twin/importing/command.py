"""`fivebar import FILE...`: reads recordings, measures the encoders' quality and writes a record."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from fivebar.errors import FiveBarError, warn
from fivebar.twin.calibrate import data
from fivebar.twin.importing import assemble, guess, maps, quality
from fivebar.twin.recording import Recording

SHOWN: Final = 5
"""Maximum number of listed gaps."""


def run(files: Sequence[Path], map_file: Path | None, scene: str | None, record: Path) -> int:
    """Writes the record, prints its content and, with a scene, a proposed map; returns 0."""
    if record.suffix.lower() != ".csv":
        raise FiveBarError(f"the record is {record}; a name that ends in .csv is needed")
    for file in (*files, *([map_file] if map_file else [])):
        if file.exists() and record.exists() and record.samefile(file):
            raise FiveBarError(
                f"the record {record} is the input file {file}, which it would replace; another name is needed"
            )
    given = maps.read(map_file) if map_file else maps.Map()
    found, used = assemble.recorded(files, given)
    figures = (quality.measure(found), quality.changes(found))
    if found.coarse:
        warn(f"{found.source}: {found.coarse}")
    lines = [*_summary(found, used, *figures), *(guess.lines(found, used, scene) if scene else [])]
    record.parent.mkdir(parents=True, exist_ok=True)
    assemble.write(found, record)
    print("\n".join(lines))
    print(f"\nwritten: {record}")
    return 0


def _summary(
    found: Recording, used: maps.Map, figures: list[quality.Quality], changes: list[quality.Changes]
) -> list[str]:
    """Lines about the content of the record."""
    lines = [f"{len(found.time)} rows, {found.time[-1]:.4g} s, {len(found.begins) + 1} series of {found.source}"]
    lines += [f"  {name} from {entry.column}" for name, entry in used.entries.items()]
    lines += [f"  {note}" for note in found.notes if note != found.coarse]
    lines += [each.sentence() for each in figures]
    for each in figures:
        long = [gap for gap in each.gaps if gap.steps > data.GAP]
        for gap in long[:SHOWN]:
            lines.append(f"  no {each.name} from {gap.begin:.3f} s on for {gap.length:.3g} s: another series")
        if len(long) > SHOWN:
            lines.append(f"  and {len(long) - SHOWN} more")
    lines += [each.sentence() for each in changes]
    lines.append("for a scene of this machine:")
    lines += [f"  {text}," for text in (*(each.lines() for each in figures), *(each.lines() for each in changes))]
    return lines
