"""`fivebar import`: a recording of a real machine as a record."""

from pathlib import Path

import click

from fivebar.commands import options


@click.command("import")
@click.argument("files", type=options.FILE, nargs=-1, required=True, metavar="FILE...")
@click.option(
    "--map", "map_file", type=options.FILE, metavar="MAP", help="Meaning of the columns: JSON (docs/recordings.md)."
)
@click.option(
    "--guess",
    "scene",
    type=options.SCENE,
    metavar="SCENE|FILE",
    help="Propose signs, exchanges and zeros of the map for this machine.",
)
@click.option("--record", "-o", type=options.FILE, required=True, metavar="RECORD", help="The written table, .csv.")
def import_(files: tuple[Path, ...], map_file: Path | None, scene: str | None, record: Path) -> int:
    """Bring in a recording of a real machine.

    FILE is a table (CSV with or without a head, or Parquet) or a bag of ROS; several are series of one machine. `calibrate`, `validate` and `twin --csv` read RECORD.
    Rate, lost samples, steps and noise of the encoders are measured, and printed as lines of a scene.

    \b
    fivebar import bench.csv --map map.json -o record.csv
    fivebar import rosbag2_2026_11_20/ --map map.json -o record.csv
    """
    options.need("calibrate")
    from fivebar.twin.importing import command

    return command.run(files, map_file, scene, record)
