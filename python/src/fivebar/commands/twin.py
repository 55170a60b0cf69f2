"""`fivebar twin`: the live twin."""

from pathlib import Path
from typing import Any

import click

from fivebar.commands import options


@click.command()
@click.option(
    "--seconds", type=float, default=60.0, show_default=True, help="Duration in real time, s; inf: until Ctrl-C."
)
@click.option(
    "--scene",
    type=options.SCENE,
    default="pick_and_place",
    show_default=True,
    metavar="SCENE|FILE",
    help="The machine and its motion.",
)
@options.learn()
@options.exact()
@click.option("--open", is_flag=True, help="Show the dashboard and keep running until Ctrl-C.")
@options.fmu()
@options.out("./twin/")
@click.option("--unit", default="bench", show_default=True, help="Name of the machine in topics.")
@click.option("--broker", metavar="HOST:PORT", help="An MQTT broker instead of the included one.")
@options.remote()
@click.option(
    "--machine",
    type=click.Choice(["stand-in", "none"]),
    default="stand-in",
    show_default=True,
    help="none: a real machine publishes meas, unless --csv plays a recording.",
)
@click.option(
    "--csv",
    type=options.FILE,
    metavar="FILE",
    help="Play a recording, such as a table of `fivebar run`, instead of a machine.",
)
@click.option(
    "--hidden",
    type=options.FILE,
    metavar="FILE",
    help="Properties of the stand-in that the twin does not know: JSON, values by name.",
)
@click.option(
    "--faults", default="", metavar="NAME=SHARE,...", help="Lose, double, delay samples on purpose, and more."
)
def twin(fmu: Path | None, out: Path | None, **given: Any) -> int:
    """Run a live twin with its dashboard.

    Machine, estimator, forecasts, recorder and watch: a simulated machine publishes its encoder samples over MQTT; the twin follows it, estimates unknown forces, looks ahead and
    warns of singularities.

    \b
    fivebar twin --open                          watch it in the browser
    fivebar twin --machine none --seconds inf    follow a machine of your own

    Exit code 1 if the machine was not followed, 3 if forecasts were not as good as promised.
    """
    options.need("twin")
    from fivebar import shipped
    from fivebar.twin import starter

    return starter.run(starter.Options(fmu=fmu or shipped.unit(), out=out or Path("twin"), **given))
