"""`fivebar map`: where a machine can go."""

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
    """Map where a machine can go.

    For each working mode: reach, singular loci, condition number, stops, the largest discs without singularity, the scene's motion; with
    limits of torque, which are those of the scene's servos unless told, the force that the tip holds at rest. Pictures, tables, and a page on
    which the machine follows the pointer.

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
