"""Runs a scene through FMPy and shows the results: CSV, pictures, an animation and a summary.

python -m fivebar.simulate --fmu target/fmu/FiveBar.fmu --scene target/scenes/paper_free_fall.json --out target/run/paper_free_fall
"""

import argparse
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import fmpy

from fivebar import animated_page, moving_picture, pictures, singularities, summary, table
from fivebar.drive import Progress, Run, StartRefused, drive
from fivebar.scene import Scene, Variant, read


ANIMATION = "animation.svg"
"""Name of the picture that moves."""


def main(arguments: list[str] | None = None) -> int:
    """Runs one scene; the exit code: 0 done, 1 the start or a step failed."""
    parser = argparse.ArgumentParser(description="Runs a scene of the five-bar through FMPy.")
    parser.add_argument("--fmu", type=Path, required=True, help="the packed .fmu")
    parser.add_argument("--scene", type=Path, required=True, help="the scene, a file of target/scenes/")
    parser.add_argument("--out", type=Path, required=True, help="folder for everything that is written")
    parser.add_argument("--method", help="an item of solver.method, in the place of the scene's own")
    options = parser.parse_args(arguments)
    if not options.fmu.is_file():
        print(f"There is no .fmu at {options.fmu}; `cargo xtask package` makes it.", file=sys.stderr)
        return 1
    scene = read(options.scene)
    directory = fmpy.extract(str(options.fmu))
    try:
        model = fmpy.read_model_description(directory, validate=False)
        if options.method:
            scene = by_method(scene, model, options.method)
        runs, refused = _drive_all(model, directory, scene)
    except (StartRefused, UnknownMethod) as error:
        print(error, file=sys.stderr)
        return 1
    finally:
        shutil.rmtree(directory, ignore_errors=True)
    report(scene, runs, refused, options.out)
    return 1 if runs[0].failed else 0


class UnknownMethod(Exception):
    """There is no such item of solver.method."""


def by_method(scene: Scene, model: fmpy.model_description.ModelDescription, name: str) -> Scene:
    """The scene with its own run by another method; its overlays stay."""
    (method,) = (v for v in model.modelVariables if v.name == "solver.method")
    numbers = {item.name: int(item.value) for item in method.declaredType.items}
    if name not in numbers:
        raise UnknownMethod(f"There is no method {name}; solver.method has: {', '.join(numbers)}.")
    own, *overlays = scene.variants
    own = Variant(name, own.values | {"solver.method": numbers[name]})
    return replace(scene, variants=[own, *overlays])


def _drive_all(model: fmpy.model_description.ModelDescription, directory: str, scene: Scene) -> tuple[list[Run], list[str]]:
    """The scene's own run and its overlays; an overlay that cannot start is a sentence, not an error."""
    runs: list[Run] = []
    refused: list[str] = []
    for variant in scene.variants:
        label = f"{scene.name} ({variant.label})"
        try:
            runs.append(drive(model, directory, scene, variant, Progress(label, scene.stop_time)))
        except StartRefused as sentence:
            if not runs:
                raise
            refused.append(f"{variant.label} did not start: {sentence}")
    return runs, refused


def report(scene: Scene, runs: list[Run], refused: list[str], out: Path) -> None:
    """Writes all files of a scene to `out` and prints the summary."""
    out.mkdir(parents=True, exist_ok=True)
    remove_earlier(out, scene.name)
    events = [singularities.find(run) for run in runs]
    print(f"{scene.name}: {scene.description}")
    for i, run in enumerate(runs):
        print(f"\n{run.label}")
        print("\n".join(summary.lines(run, events[i])))
        if i > 0:
            print(summary.difference(runs[0], run))
    for sentence in refused:
        print(f"\n{sentence}")

    files = []
    for i, run in enumerate(runs):
        files.append(out / (f"{scene.name}.csv" if i == 0 else f"{scene.name}.{slug(run.label)}.csv"))
        table.write(files[-1], run)
    files.append(out / "singularities.csv")
    singularities.write(files[-1], events[0])
    files += pictures.draw_all(out, scene, runs, events[0])
    if moving_picture.wanted(runs[0]):
        files.append(out / ANIMATION)
        moving_picture.write(files[-1], scene, runs[0], events[0])
    files.append(out / f"{scene.name}.html")
    animated_page.write(files[-1], scene, runs, events[0])
    print("\nWritten:")
    for file in files:
        print(f"  {_shown(file)}  ({_size(file.stat().st_size)})")


def remove_earlier(out: Path, name: str) -> None:
    """Removes the files that an earlier run of the scene `name` wrote to `out`, and nothing else."""
    own_table = re.compile(re.escape(name) + r"(\.[a-z0-9-]*)?\.csv")
    fixed = {"singularities.csv", f"{name}.html", ANIMATION, *pictures.FILES}
    for file in out.iterdir():
        if file.is_file() and (file.name in fixed or own_table.fullmatch(file.name)):
            file.unlink()


def slug(label: str) -> str:
    """`label` as a part of a file name."""
    return re.sub(r"[^a-z0-9]+", "-", label.lower()).strip("-")


def _shown(file: Path) -> Path:
    """`file` as seen from the current directory, if it lies inside."""
    file, here = file.resolve(), Path.cwd().resolve()
    return file.relative_to(here) if file.is_relative_to(here) else file


def _size(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{max(size / 1e3, 0.1):.1f} kB"


if __name__ == "__main__":
    sys.exit(main())
