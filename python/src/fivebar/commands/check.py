"""`fivebar check`: checks of a record of a machine."""

from pathlib import Path

import click

from fivebar.commands import options


@click.command()
@click.argument("scene", type=options.SCENE, metavar="SCENE|FILE")
@click.argument("file", type=options.FILE, required=False)
@click.option(
    "--map", "map_file", type=options.FILE, metavar="MAP", help="Meaning of the columns: JSON (docs/recordings.md)."
)
@click.option(
    "--broker", metavar="HOST:PORT", help="Listen to a machine that publishes meas, instead of reading a file."
)
@click.option(
    "--seconds",
    type=float,
    default=10.0,
    show_default=True,
    metavar="S",
    help="Duration of listening to the broker, s.",
)
@click.option("--unit", default="", help="Name of the machine in topics, if there are several.")
@options.remote()
def check(
    scene: str,
    file: Path | None,
    map_file: Path | None,
    broker: str | None,
    seconds: float,
    unit: str,
    user: str,
    ca_file: str,
) -> int:
    """Check a record of a machine against its scene.

    Checks units, clock, rate, jitter, dead encoders, turns and reach. If the record has angles of distal links, the tip, commands or torques, it
    also checks signs, exchanges and zeros. A line with `fix` needs a change, which is printed for copying into the map or the scene; a line with
    `?` is a choice that the record cannot decide. FILE is a file that `import` takes, or a record of `fivebar twin`.

    \b
    fivebar check my_machine.json bench.csv --map map.json
    fivebar check my_machine.json --broker 127.0.0.1:1883

    Exit code 1 if something needs a fix.
    """
    if (file is None) == (broker is None):
        raise click.UsageError("one is needed: a FILE, or --broker")
    options.need("calibrate" if broker is None else "twin")
    from fivebar.twin.importing import check as work

    if file is not None:
        return work.run(scene, work.of_file(file, map_file, unit, scene))
    if map_file is not None:
        raise click.UsageError(f"--map is {map_file}, but samples from a broker have no columns")
    from fivebar.twin import config, listen

    heard = listen.hear(config.other_broker(broker or "", user, ca_file), unit, seconds)
    return work.run(scene, work.of_recording(heard))
