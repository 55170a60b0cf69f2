"""`fivebar what-if`: commands compared from the running twin's state."""

from typing import Any

import click

from fivebar.commands import options


@click.command("what-if")
@click.option(
    "--config", type=options.FILE, required=True, metavar="FILE", help="Of the running twin: twin/runs/RUN/twin.json."
)
@click.option(
    "--candidates",
    type=options.FILE,
    metavar="FILE",
    help="Commands to compare, and a goal; else staying, and a little to each side.",
)
@click.option("--members", type=int, default=50, show_default=True, metavar="N", help="Motions of each command.")
@click.option("--seconds", type=float, default=0.5, show_default=True, metavar="S", help="How far ahead.")
@click.option(
    "--seed", type=int, default=0, show_default=True, metavar="N", help="The same seed gives the same members."
)
@click.option(
    "--times",
    type=int,
    default=1,
    show_default=True,
    metavar="N",
    help="How many snapshots are answered; 0: until Ctrl-C.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="A scheduler of Dask, which needs fivebar[cluster]; else all in this process.",
)
def what_if(**given: Any) -> int:
    """Compare commands from the running twin's state.

    Each command is run by the same uncertain members; the better one meets a singularity less probably and ends nearer to the goal. The
    answer is printed, and published as `whatif`.

    \b
    fivebar twin --seconds inf &
    fivebar what-if --config twin/runs/20261124-060000-1234/twin.json
    """
    options.need("ensemble")
    if given["scheduler"]:
        options.need("cluster")
    from fivebar.twin.ensemble import what_if as work

    return work.run(work.Options(**given))
