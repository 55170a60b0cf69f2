"""Cost of the effects of each scene against the bare mechanism: seconds in fmi2DoStep and sub-steps, as a table and as CSV.

python prices.py --fmu target/fmu/FiveBar.fmu --scenes scenes --out target/run/prices.csv
"""

import argparse
import csv
import io
import sys
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from fivebar.drive import Progress, Run, drive
from fivebar.errors import FiveBarError
from fivebar.library import Library
from fivebar.scene import Scene, Variant, read
from fivebar.variables import Values

STEP = 0.02
"""Communication step, s. 20 macro steps share one call, so that the call's own cost, some microseconds in Python, is negligible."""

REPEATS = 15
"""Number of equal runs. The fastest counts for each call, because other load on the machine only adds time."""


@dataclass(frozen=True)
class Price:
    """One row: a scene with its effects, and bare (same start and inputs, no effect except gravity if it was on).

    A scene that is already bare is measured once.
    """

    scene: str
    effects: str
    substeps_per_step: float
    us_per_step: float
    us_per_substep: float
    bare_substeps_per_step: float
    bare_us_per_step: float
    bare_us_per_substep: float


def main(arguments: list[str] | None = None) -> int:
    """Measures all scenes of a folder."""
    parser = argparse.ArgumentParser(description="Cost of the effects of each scene against the bare mechanism.")
    parser.add_argument("--fmu", type=Path, required=True, help="the packed .fmu")
    parser.add_argument("--scenes", type=Path, required=True, help="the folder scenes/")
    parser.add_argument("--method", help="an item of solver.method for all scenes [default: the method of each]")
    parser.add_argument("--out", type=Path, required=True, help="the CSV file to write")
    options = parser.parse_args(arguments)
    library = Library(options.fmu)
    try:
        method = {"solver.method": library.known["solver.method"].value(options.method)} if options.method else {}
    except FiveBarError as error:
        raise SystemExit(str(error)) from None
    prices = [_price(library, read(path, library.known), method) for path in sorted(options.scenes.glob("*.json"))]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([f.name for f in fields(Price)])
        writer.writerows(map(astuple, prices))
    print(table(prices))
    return 0


def table(prices: list[Price]) -> str:
    """The rows as Markdown, for docs/notes/effects.md."""
    lines = [
        "| scene | effects | sub-steps per step | µs per step | µs per sub-step | the same bare | price of a sub-step |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for p in prices:
        lines.append(
            f"| `{p.scene}` | {p.effects} | {p.substeps_per_step:.2f} | {p.us_per_step:.2f} | {p.us_per_substep:.3f} "
            f"| {p.bare_us_per_substep:.3f} | {p.us_per_substep / p.bare_us_per_substep:.2f} |"
        )
    return "\n".join(lines)


def _price(library: Library, scene: Scene, method: Values) -> Price:
    scene = scene.coarser(STEP)
    own = Variant(scene.variants[0].label, scene.variants[0].values | method)
    switches = {name: start for name, start in library.known.start.items() if name.endswith(".enabled")}
    active = [name for name, start in switches.items() if own.values.get(name, start)]
    off = {name: False for name in active if name != "gravity.enabled"}
    variants = [own, Variant("bare", own.values | off)] if off else [own]
    # Alternating, so that other load on the machine affects both.
    runs = [[_run(library, scene, variant) for variant in variants] for _ in range(REPEATS)]
    numbers = [_numbers(list(same)) for same in zip(*runs)]
    effects = ", ".join(name.removesuffix(".enabled") for name in active) or "none"
    return Price(scene.name, effects, *numbers[0], *numbers[-1])


def _run(library: Library, scene: Scene, variant: Variant) -> Run:
    run = drive(library, scene, variant, Progress(scene.name, scene.stop_time, io.StringIO()))
    if run.failed:
        raise SystemExit(f"{scene.name} ({variant.label}) ended early: {run.failure}")
    return run


def _numbers(runs: list[Run]) -> tuple[float, float, float]:
    """Sub-steps per step, microseconds per step and per sub-step, over equal runs."""
    steps, substeps = (int(runs[0][f"solver.{counter}"][-1]) for counter in ("steps", "substeps"))
    fastest = 1e6 * sum(map(min, zip(*(run.call_seconds for run in runs))))
    return substeps / steps, fastest / steps, fastest / substeps


if __name__ == "__main__":
    sys.exit(main())
