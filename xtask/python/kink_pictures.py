"""The picture of loads with kinks in docs/effects.md: stick-slip, a bounce, a hold.

python kink_pictures.py --fmu target/fmu/FiveBar.fmu --scenes scenes --out docs/images/kinks.svg
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from fivebar.colours import LEFT, TIP
from fivebar.drawing import FAINT, INK, plane, thinned
from fivebar.drive import Progress, Run, drive
from fivebar.library import Library
from fivebar.scene import Scene, Variant, read

LAWS = {"smooth": 1, "stick": 2}
"""The items of `friction.law`."""


def held(scene: Scene, law: str) -> Scene:
    """The joint of `stick_slip` under a constant servo torque of half its breakaway torque, with a friction law."""
    values = scene.variants[0].values
    pull = values["friction.breakaway[1]"] / 2 / values["servo.kp[1]"]
    load = {
        "servo.theta[1]": values["init.theta[1]"] + pull,
        "friction.law": LAWS[law],
        "friction.breakawayVelocity": 1e-3,
    }
    return replace(scene, stop_time=2.0, signals={}, variants=[Variant(law, values | load)])


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Draws stick-slip, a bounce and a hold.")
    parser.add_argument("--fmu", type=Path, required=True, help="the packed .fmu")
    parser.add_argument("--scenes", type=Path, required=True, help="the folder scenes/")
    parser.add_argument("--out", type=Path, required=True, help="the SVG file to write")
    options = parser.parse_args(arguments)
    library = Library(options.fmu)
    known = library.known
    figure, (slip, bounce, hold) = plt.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
    draw_stick_and_slip(slip, run(library, read(options.scenes / "stick_slip.json", known)))
    draw_bounce(bounce, run(library, read(options.scenes / "bounce.json", known)))
    draw_hold(hold, [run(library, held(read(options.scenes / "stick_slip.json", known), law)) for law in LAWS])
    options.out.parent.mkdir(parents=True, exist_ok=True)
    matplotlib.rcParams["svg.hashsalt"] = "kinks"
    figure.savefig(options.out, metadata={"Date": None})
    return 0


def run(library: Library, scene: Scene) -> Run:
    """Runs a scene."""
    return drive(library, scene, scene.variants[0], Progress(scene.name, scene.stop_time))


def draw_stick_and_slip(axes: Axes, found: Run) -> None:
    """Angle and reference relative to the start, mrad."""
    start = found["theta[1]"][0]
    for values, colour, label in ((found["servo.theta[1]"], FAINT, "reference"), (found["theta[1]"], LEFT, "angle")):
        axes.plot(*thinned(found.time, 1e3 * (values - start), buckets=400), color=colour, linewidth=1.4, label=label)
    axes.set(title="stick and slip", xlabel="time  (s)", ylabel="left motor from its start  (mrad)")
    axes.legend()


def draw_bounce(axes: Axes, found: Run) -> None:
    """Gap between tip and floor, mm."""
    normal, offset = plane(found)
    gap = normal[0] * found["tip.x"] + normal[1] * found["tip.y"] - offset
    axes.plot(*thinned(found.time, 1e3 * gap, buckets=400), color=TIP, linewidth=1.4)
    axes.axhline(0, color=FAINT, linewidth=1)
    axes.set(title="a bounce", xlabel="time  (s)", ylabel="tip above the floor  (mm)")


def draw_hold(axes: Axes, runs: list[Run]) -> None:
    """Angle relative to its start under a constant load, µrad."""
    for found, colour in zip(runs, (FAINT, INK)):
        moved = found["theta[1]"] - found["theta[1]"][0]
        axes.plot(*thinned(found.time, 1e6 * moved, buckets=400), color=colour, linewidth=1.4, label=found.label)
    axes.set(title="a hold", xlabel="time  (s)", ylabel="left motor from its start  (µrad)")
    axes.legend()


if __name__ == "__main__":
    sys.exit(main())
