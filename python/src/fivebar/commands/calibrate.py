"""`fivebar calibrate`: parameters of a machine from a record."""

from pathlib import Path
from typing import Any

import click

from fivebar.commands import options


@click.command()
@click.argument("file", type=options.FILE, required=False)
@click.option(
    "--parameters",
    multiple=True,
    metavar="NAME",
    help="An unknown, or a group such as link[1,4].mass; may be repeated; default: the usual unknowns.",
)
@click.option(
    "--scene",
    type=options.SCENE,
    metavar="SCENE|FILE",
    help="The assumed machine; default: the scene of the record.",
)
@click.option(
    "--from",
    "begin",
    type=float,
    default=0.0,
    show_default=True,
    metavar="S",
    help="Begin of the used part, s after the first sample.",
)
@click.option(
    "--seconds", type=float, default=10.0, show_default=True, metavar="S", help="Length of the used part, s; inf: all."
)
@click.option(
    "--longest", type=float, default=10.0, show_default=True, metavar="S", help="Series longer than this, s, are cut."
)
@click.option(
    "--commands",
    type=click.Choice(["rate", "linear", "hold"]),
    default="rate",
    show_default=True,
    help="Commands of the drives between samples.",
)
@click.option(
    "--patience",
    type=float,
    default=120.0,
    show_default=True,
    metavar="S",
    help="CPU time, s, after which a fit is abandoned.",
)
@click.option("--unit", default="", help="Name of the machine, if the record has several.")
@click.option(
    "--proposal/--no-proposal", default=True, help="Search for a motion that identifies the remaining unknowns."
)
@options.fmu()
@options.out("./calibrate/")
@click.option(
    "--trials",
    type=int,
    metavar="N",
    help="Without FILE: calibrate N made records and count how often error bars hold the truth.",
)
@click.option(
    "--machines",
    type=click.Choice(["one", "any"]),
    default="one",
    show_default=True,
    help="For trials: one machine with six wrong parameters, or random machines.",
)
@click.option("--first", type=int, default=100, show_default=True, metavar="K", help="Number of the first trial.")
def calibrate(
    file: Path | None, fmu: Path | None, out: Path | None, trials: int | None, machines: str, first: int, **given: Any
) -> int:
    """Find masses, friction and lengths from a record.

    FILE is a record of `fivebar twin` (Parquet, or a folder of parts) or a table (CSV or Parquet) with time, measured.theta[1..2] (or theta[1..2]) and the commands of the drives.
    Payload, gravity, offsets and delay of the encoders can be unknowns, too. Every value has an error bar. Unknowns that the record cannot
    identify are named, with a motion that would identify them.

    \b
    fivebar calibrate twin/runs/20261124-060000-1234/record
    fivebar calibrate bench.csv --scene my_machine.json --parameters payload.mass --parameters viscous.b

    Exit code 1 if nothing is identified, or the record is not of this machine.
    """
    options.need("calibrate")
    from fivebar import shipped

    unit, folder = fmu or shipped.unit(), out or Path("calibrate")
    if trials is not None:
        from fivebar.twin.calibrate import trials as work

        return work.run(trials, first, machines, unit, folder)
    if file is None:
        raise click.UsageError("a FILE is needed: a record, a folder of its parts, or a table")
    from fivebar.twin.calibrate import command

    return command.run(command.Options(file=file, fmu=unit, out=folder, **given))
