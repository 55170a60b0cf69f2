"""`fivebar ensemble`: many uncertain motions."""

from pathlib import Path
from typing import Any

import click

from fivebar.commands import options


@click.command()
@click.option("--members", type=int, default=1000, show_default=True, metavar="N", help="Number of motions.")
@click.option("--scene", type=options.SCENE, metavar="SCENE|FILE", help="Scene of the motions; default: fall_90_120.")
@click.option(
    "--state",
    type=options.FILE,
    metavar="FILE",
    help="A stored state to start from: bytes of the unit, or of the twin (state/twin.json).",
)
@click.option(
    "--vary",
    multiple=True,
    metavar="NAME=SD",
    help="A standard deviation, such as link[1,4].mass=2% or theta[1]=0.01; may be repeated.",
)
@click.option("--seconds", type=float, default=2.0, show_default=True, metavar="S", help="Duration of each motion, s.")
@click.option(
    "--points", type=int, default=100, show_default=True, metavar="N", help="Number of stored points of time."
)
@click.option("--seed", type=int, default=0, show_default=True, metavar="N", help="The same seed gives the same bytes.")
@click.option(
    "--workers",
    type=int,
    default=2,
    show_default=True,
    metavar="N",
    help="Number of processes on this machine; 0: this process only.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="A Dask scheduler instead of processes on this machine; needs fivebar[cluster].",
)
@click.option("--measure", is_flag=True, help="Also run all in one process, and report the efficiency of the workers.")
@options.fmu()
@options.out("./ensemble/")
def ensemble(scene: str | None, state: Path | None, fmu: Path | None, out: Path | None, **given: Any) -> int:
    """Run many motions with uncertain starts and masses.

    Reports the probable places of the machine, and when it meets its next singularity. By default starts vary by 2 mrad and masses by 1 %.

    \b
    fivebar ensemble --members 10000
    fivebar ensemble --scene pick_and_place --vary payload.mass=5% --vary theta[1]=0.002 --seed 7

    Exit code 1 if a member ended early.
    """
    if scene is not None and state is not None:
        raise click.UsageError("--scene and --state are both given; one start is needed")
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
