"""`fivebar what-if`: commands compared from the running twin's state."""

from typing import Any

import click

from fivebar.commands import options


@click.command("what-if")
@click.option(
    "--config",
    type=options.FILE,
    required=True,
    metavar="FILE",
    help="Configuration of the running twin: twin/runs/RUN/twin.json.",
)
@click.option(
    "--candidates",
    type=options.FILE,
    metavar="FILE",
    help="Commands to compare, and a goal; default: staying, and a small step to each side.",
)
@click.option(
    "--members", type=int, default=50, show_default=True, metavar="N", help="Number of motions for each command."
)
@click.option("--seconds", type=float, default=0.5, show_default=True, metavar="S", help="Horizon, s.")
@click.option(
    "--seed", type=int, default=0, show_default=True, metavar="N", help="The same seed gives the same members."
)
@click.option(
    "--times",
    type=int,
    default=1,
    show_default=True,
    metavar="N",
    help="Number of answers; 0: until Ctrl-C.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="A Dask scheduler, which needs fivebar[cluster]; default: this process only.",
)
def what_if(**given: Any) -> int:
    """Compare commands from the running twin's state.

    Each command is run with the same uncertain members. A better command meets a singularity with less probability and ends nearer to the goal. The
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
