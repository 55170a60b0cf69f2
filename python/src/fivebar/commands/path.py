"""`fivebar path`: times, checks and runs a drawing with a scene's machine."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fivebar.commands import options

if TYPE_CHECKING:
    from fivebar.pieces import Profile


def place(value: str) -> tuple[float, float]:
    """The coordinates in `X,Y`, m."""
    try:
        x, y = map(float, value.split(","))
    except ValueError:
        raise click.BadParameter(f"{value!r:.40} is not a place X,Y in m, such as 0.05,0.24") from None
    if not (math.isfinite(x) and math.isfinite(y)):
        raise click.BadParameter(f"{value!r:.40} is not a place: both coordinates must be finite")
    return x, y


@click.command()
@click.argument("scene", type=options.SCENE, metavar="SCENE|FILE")
@click.argument("drawing", type=options.FILE, metavar="DRAWING")
@click.option("--at", type=place, required=True, metavar="X,Y", help="Place of the middle of the drawing, m.")
@click.option(
    "--size", type=options.POSITIVE, metavar="W", help="Width of the drawing, m; default: the drawing's own size."
)
@click.option(
    "--speed", type=options.POSITIVE, default=0.1, show_default=True, metavar="V", help="Speed of the pen, m/s."
)
@click.option(
    "--acceleration",
    type=options.POSITIVE,
    default=2.0,
    show_default=True,
    metavar="A",
    help="Acceleration along the lines, m/s2.",
)
@click.option(
    "--profile",
    type=click.Choice(["constant", "minimumJerk"]),
    default="constant",
    show_default=True,
    help="Profile of the speed.",
)
@options.mode(multiple=False)
@options.torque()
@click.option(
    "--rate",
    type=options.POSITIVE,
    default=math.inf,
    metavar="W",
    help="Limit of the motors' rates, rad/s; default: none.",
)
@click.option("--no-run", is_flag=True, help="Only write the scene, without running it.")
@options.out("./SCENE/")
def path(
    scene: str,
    drawing: Path,
    at: tuple[float, float],
    size: float | None,
    speed: float,
    acceleration: float,
    profile: "Profile",
    mode: str | None,
    torque: tuple[float, float] | None,
    rate: float,
    no_run: bool,
    out: Path | None,
) -> None:
    """Let a machine draw.

    The drawing becomes a scene, which the unit runs; a picture shows the commanded and the actual path. DRAWING is an .svg, with lines, arcs and
    curves of any colour, or a .csv with rows x,y or x,y,pen. Lengths are in mm unless the file names another unit; y points up. If the drawing
    needs more torque than the limits (default: the limits of the scene's servos), it takes longer. A drawing that leaves the reach, or meets a
    stop or a singularity, is refused with the place and a picture.

    \b
    fivebar path pick_and_place logo.svg --at 0.05,0.26 --size 0.18
    fivebar path my_machine.json lines.csv --at 0.1,0.2 --speed 0.2 --profile minimumJerk
    """
    from fivebar import path_pictures, paths, simulate, strokes
    from fivebar import scene as scenes
    from fivebar.drive import Progress
    from fivebar.errors import FiveBarError
    from fivebar.pieces import Timing

    ready = scenes.read(scene)
    if not ready["servo.enabled"]:
        raise FiveBarError(
            f"the scene {ready.name} has servo.enabled = false, but servos must follow the drawing: enable them, and set their gains"
        )
    folder = Path(ready.name) if out is None else out
    placed = strokes.read(drawing).placed(at, size)
    working = paths.mode_of(ready) if mode is None else options.WORKING_MODES[mode]
    limits = paths.Limits(rate, torque or paths.servo_limits(ready))
    try:
        made = paths.plan(ready, placed, Timing(profile, speed, acceleration), working, limits)
    except paths.Blocked as error:
        file = path_pictures.draw_blocked(ready, working, placed, error, drawing.name, folder)[-1]
        raise FiveBarError(f"{error}; {file} shows the place") from None
    folder.mkdir(parents=True, exist_ok=True)
    written = folder / f"{drawing.stem}.json"
    paths.write_scene(made, written, drawing.name)
    click.echo("\n".join([*placed.left_out, made.words(drawing.name)]))
    files = [written]
    outcome = None
    if not no_run:
        outcome = paths.compare(made, simulate.run(written, progress=Progress, on_failure="return"))
        click.echo(outcome.words())
        files += path_pictures.draw(outcome, drawing.name, limits, folder)
    files.append(paths.write_table(made, outcome, folder / f"{drawing.stem}.csv"))
    options.written(files)
