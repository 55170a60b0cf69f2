"""`fivebar replay`: computes a record's estimates again."""

import math
from pathlib import Path

import click

from fivebar.commands import options


@click.command()
@click.argument("file", type=options.FILE)
@options.fmu()
@click.option(
    "--since",
    type=float,
    default=-math.inf,
    metavar="SECONDS",
    help="Begin, s after the record's first message.",
)
@click.option("--until", type=float, default=math.inf, metavar="SECONDS", help="End, likewise.")
def replay(file: Path, fmu: Path | None, since: float, until: float) -> int:
    """Compute a record's estimates again and compare the bits.

    FILE is a record of `fivebar twin`: a Parquet file, or the folder of its parts.

    \b
    fivebar replay twin/runs/20261124-060000-1234/record

    Exit code 1 if an estimate differs, 3 if more were left out than compared.
    """
    options.need("twin")
    from fivebar import shipped
    from fivebar.twin import replay as work

    return work.run(file, fmu or shipped.unit(), since, until)
