"""`fivebar run`: runs a scene."""

from pathlib import Path

import click

from fivebar.commands import completion, options


@click.command()
@click.argument("scene", type=options.SCENE, metavar="SCENE|FILE")
@click.option(
    "--set",
    "changes",
    type=completion.Assignment(),
    multiple=True,
    metavar="NAME=VALUE",
    help="Another start value, in the variable's unit; may be repeated.",
)
@click.option(
    "--method",
    type=completion.Method(),
    metavar="NAME",
    help="Another method, an item of solver.method such as automatic.",
)
@click.option("--stop-time", type=options.POSITIVE, metavar="SECONDS", help="Stop time instead of the scene's.")
@click.option(
    "--step-size",
    type=options.POSITIVE,
    metavar="SECONDS",
    help="Time between rows of the table instead of the scene's.",
)
@click.option(
    "--outputs",
    type=completion.Columns(),
    multiple=True,
    metavar="NAMES",
    help="Columns of the table: names or prefixes, such as tip,energy.error; may be repeated; default: all.",
)
@click.option("--no-pictures", is_flag=True, help="Only write tables and the animated page.")
@options.fmu()
@options.out("./SCENE/")
@click.option("--open", "open_page", is_flag=True, help="Show the animated page in the browser.")
def run(
    scene: str,
    changes: tuple[str, ...],
    method: str | None,
    stop_time: float | None,
    step_size: float | None,
    outputs: tuple[str, ...],
    no_pictures: bool,
    fmu: Path | None,
    out: Path | None,
    open_page: bool,
) -> int:
    """Run a scene: summary, CSV, pictures and an animated page.

    SCENE is a name that `fivebar scenes` lists; FILE ends in .json and contains start values by name.

    \b
    fivebar run fall_90_120 --open
    fivebar run swing --set link[1].mass=0.02 --set viscous.enabled=true --method automatic
    fivebar run my_machine.json --out results --outputs tip,theta --no-pictures

    Exit code 1 if a step failed; the results up to then are written.
    """
    from fivebar import scene as scenes
    from fivebar import simulate
    from fivebar.drive import Progress
    from fivebar.progress import Line
    from fivebar.result import check_foreign
    from fivebar.variables import of_unit

    ready = scenes.read(scene, of_unit(fmu)).replace(
        options.assignments(changes), method=method, stop_time=stop_time, step_size=step_size
    )
    folder = Path(ready.name) if out is None else out
    options.check_folder(folder)
    check_foreign(folder, ready.name, [variant.label for variant in ready.variants], not no_pictures)
    result = simulate.run(ready, fmu, overlays=True, progress=Progress, outputs=outputs, on_failure="return")
    click.echo(result.summary())
    line = Line()
    try:
        files = result.save(folder, draw=not no_pictures, show=open_page, progress=line.show)
    finally:
        line.finish()
    if not outputs:
        click.echo(f"\n{result.columns()}; --outputs NAMES writes some of them")
    options.written(files)
    return 1 if result.failure else 0
