"""`fivebar map`: the workspace of a machine."""

import webbrowser
from pathlib import Path

import click

from fivebar.commands import options


@click.command("map")
@click.argument("scene", type=options.SCENE, metavar="SCENE|FILE")
@options.mode(multiple=True)
@options.torque()
@click.option("--no-motion", is_flag=True, help="Do not run the scene to show its motion.")
@options.out("./SCENE/")
@click.option("--open", "open_page", is_flag=True, help="Show the interactive page in the browser.")
def map_(
    scene: str,
    mode: tuple[str, ...],
    torque: tuple[float, float] | None,
    no_motion: bool,
    out: Path | None,
    open_page: bool,
) -> None:
    """Map the workspace of a machine.

    For each working mode: reach, singular loci, condition number, stops, the largest discs without singularity, the scene's motion.
    With torque limits (default: the limits of the scene's servos) also the force that the tip can hold at rest. Writes pictures, tables, and a
    page on which the machine follows the pointer.

    \b
    fivebar map pick_and_place --open
    fivebar map my_machine.json --mode minusPlus --torque 0.5 0.5
    """
    from fivebar import map_page, workspace, workspace_pictures
    from fivebar import scene as scenes

    ready = scenes.read(scene)
    modes = [options.WORKING_MODES[name] for name in mode] or list(options.WORKING_MODES.values())
    survey = workspace.compute(ready, torque, None if no_motion else workspace.follow(ready), modes=modes)
    folder = Path(ready.name) if out is None else out
    files = [
        *workspace.write(survey, folder),
        *workspace_pictures.draw(survey, folder),
        map_page.write(survey, folder / "map.html"),
    ]
    click.echo("\n".join(workspace.summary(survey)))
    options.written(files)
    if open_page:
        webbrowser.open(files[-1].resolve().as_uri())
