"""`fivebar ensemble`: many uncertain motions."""

from pathlib import Path
from typing import Any

import click

from fivebar.commands import options


@click.command()
@click.option("--members", type=int, default=1000, show_default=True, metavar="N", help="How many motions.")
@click.option(
    "--scene", type=options.SCENE, metavar="SCENE|FILE", help="Where and how they begin; fall_90_120 unless told."
)
@click.option(
    "--state",
    type=options.FILE,
    metavar="FILE",
    help="A stored state: bytes of the unit, or of the twin (state/twin.json).",
)
@click.option(
    "--vary",
    multiple=True,
    metavar="NAME=SD",
    help="A standard deviation, once or more, as link[1,4].mass=2% or theta[1]=0.01.",
)
@click.option("--seconds", type=float, default=2.0, show_default=True, metavar="S", help="How long each is.")
@click.option("--points", type=int, default=100, show_default=True, metavar="N", help="Points of time that are kept.")
@click.option("--seed", type=int, default=0, show_default=True, metavar="N", help="The same seed gives the same bytes.")
@click.option(
    "--workers",
    type=int,
    default=2,
    show_default=True,
    metavar="N",
    help="Processes on this machine; 0: all in this one.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="A scheduler of Dask, in the place of processes on this machine; needs fivebar[cluster].",
)
@click.option("--measure", is_flag=True, help="Run all in one process as well, and say how efficient the workers are.")
@options.fmu()
@options.out("./ensemble/")
def ensemble(scene: str | None, state: Path | None, fmu: Path | None, out: Path | None, **given: Any) -> int:
    """Run many motions with uncertain starts and masses.

    Says where the machine will be with which probability, and when it meets its next singularity; unless told, starts vary by 2 mrad and
    masses by 1 %.

    \b
    fivebar ensemble --members 10000
    fivebar ensemble --scene pick_and_place --vary payload.mass=5% --vary theta[1]=0.002 --seed 7

    Exit code 1 if a member did not come to its end.
    """
    if scene is not None and state is not None:
        raise click.UsageError("--scene and --state are two starts, and one is needed")
    options.need("ensemble")
    if given["scheduler"]:
        options.need("cluster")
    from fivebar import shipped
    from fivebar.twin.ensemble import command

    return command.run(
        command.Options(
            scene=scene or "fall_90_120", state=state, fmu=fmu or shipped.unit(), out=out or Path("ensemble"), **given
        )
    )
