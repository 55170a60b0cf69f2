"""`fivebar calibrate`: what a machine is, from a record."""

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
    help="What is sought, once or more, groups as link[1,4].mass; else what is usual.",
)
@click.option(
    "--scene",
    type=options.SCENE,
    metavar="SCENE|FILE",
    help="What the machine is taken for before; without it the scene of the record.",
)
@click.option(
    "--from", "begin", type=float, default=0.0, show_default=True, metavar="S", help="s after the first sample."
)
@click.option(
    "--seconds", type=float, default=10.0, show_default=True, metavar="S", help="How much of the record is used."
)
@click.option(
    "--longest", type=float, default=10.0, show_default=True, metavar="S", help="Series longer than this are cut."
)
@click.option(
    "--commands",
    type=click.Choice(["rate", "linear", "hold"]),
    default="rate",
    show_default=True,
    help="What drives do between samples.",
)
@click.option(
    "--patience",
    type=float,
    default=120.0,
    show_default=True,
    metavar="S",
    help="s of CPU after which a fit is given up.",
)
@click.option("--unit", default="", help="Which machine, if the record has several.")
@click.option(
    "--proposal/--no-proposal", default=True, help="Look for a motion that would tell what is not identified."
)
@options.fmu()
@options.out("./calibrate/")
@click.option("--trials", type=int, metavar="N", help="No FILE: calibrate N made records, count what error bars cover.")
@click.option(
    "--machines",
    type=click.Choice(["one", "any"]),
    default="one",
    show_default=True,
    help="Of trials: one machine with six unknowns off, or each another.",
)
@click.option(
    "--first", type=int, default=100, show_default=True, metavar="K", help="Number of the first of these trials."
)
def calibrate(
    file: Path | None, fmu: Path | None, out: Path | None, trials: int | None, machines: str, first: int, **given: Any
) -> int:
    """Find masses, friction and lengths from a record.

    FILE is a record of `fivebar twin` (Parquet, or a folder of parts) or CSV with time, measured.theta[1..2] (or theta[1..2]) and what drives were told.
    Also payload, gravity, offsets and delay of the encoders. Every value comes with its error bar; what the record does not tell is said, with a motion that would tell it.

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
        raise click.UsageError("a FILE is needed: a record (Parquet), a folder of its parts, or CSV")
    from fivebar.twin.calibrate import command

    return command.run(command.Options(file=file, fmu=unit, out=folder, **given))
