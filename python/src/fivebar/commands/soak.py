"""`fivebar soak`: follows hours of samples and checks for losses and growing memory."""

from pathlib import Path
from typing import Any

import click

from fivebar.commands import options


@click.command()
@click.option("--hours", type=float, default=1.0, show_default=True, help="Duration, h, at 200 samples a second.")
@click.option(
    "--scene",
    type=options.SCENE,
    default="pick_and_place",
    show_default=True,
    metavar="SCENE|FILE",
    help="The machine and its motion.",
)
@click.option("--faults", default="", metavar="NAME=SHARE,...", help="As for `fivebar twin`.")
@options.learn()
@options.exact()
@options.fmu()
def soak(fmu: Path | None, **given: Any) -> int:
    """Let the twin follow hours of samples as fast as it can.

    It runs without broker and clock. No sample may be lost, and memory must not grow.

    Exit code 1 if either fails, 3 if forecasts were not as good as promised.
    """
    options.need("twin")
    from fivebar import shipped
    from fivebar.twin import soak as work

    return work.run(work.Options(fmu=fmu or shipped.unit(), **given))
