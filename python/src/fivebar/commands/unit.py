"""`fivebar unit`: the .fmu for any master."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fivebar.commands import options

if TYPE_CHECKING:
    from fivebar.own_unit import Naming


@click.command()
@click.option(
    "--scene",
    type=options.SCENE,
    metavar="SCENE|FILE",
    help="Start values, experiment and description of the unit: a machine of your own.",
)
@click.option("--name", help="Name of the unit; default: FiveBar, or the scene's name in CamelCase.")
@click.option(
    "--naming",
    type=click.Choice(["structured", "flat"]),
    default="structured",
    show_default=True,
    help="flat: for tools that make buses of tip.x and tau[1].",
)
@options.out("the current folder")
def unit(scene: str | None, name: str | None, naming: "Naming", out: Path | None) -> None:
    """Write the .fmu for your own tool or machine.

    Any FMI 2.0 master runs it without setting a value, on every platform of the shipped unit. No compiler is needed.

    \b
    fivebar unit                                          FiveBar.fmu
    fivebar unit --scene my_machine.json                  MyMachine.fmu
    fivebar unit --scene my_machine.json --naming flat    for Simulink
    """
    from fivebar import own_unit
    from fivebar import scene as scenes

    written = own_unit.write_unit(out or Path(), None if scene is None else scenes.read(scene), name, naming=naming)
    click.echo(written.file)
    for sentence in written.notes:
        click.echo(f"  {sentence}")
