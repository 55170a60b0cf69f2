"""`fivebar export`: a record as a file for viewers."""

from pathlib import Path

import click

from fivebar.commands import options


@click.command()
@click.argument("record", type=options.FILE)
@click.option("--mcap", is_flag=True, help="Write RECORD.mcap for Foxglove, which needs fivebar[mcap].")
@click.option("--rerun", is_flag=True, help="Write RECORD.rrd for Rerun, which needs fivebar[rerun].")
@options.out("the current folder")
def export(record: Path, mcap: bool, rerun: bool, out: Path | None) -> int:
    """Write a record of the twin for Foxglove or Rerun.

    Samples, estimates, forecasts, alarms and learned values as time series, and the machine with the band of its tip and the forecast as a scene.

    \b
    fivebar twin --seconds 20
    fivebar export twin/runs/RUN/record --mcap
    """
    if not (mcap or rerun):
        raise click.UsageError("a format is needed: --mcap, --rerun or both")
    options.need("twin")
    folder = out or Path()
    options.check_folder(folder)
    for extra in [name for name, wanted in (("mcap", mcap), ("rerun", rerun)) if wanted]:
        options.need(extra)
    from fivebar.twin.exporting import work

    machine = work.machine(record)
    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    writers: list[work.Writer] = []
    if mcap:
        from fivebar.twin.exporting.mcap import Writer as Mcap

        files.append(folder / f"{record.stem}.mcap")
        writers.append(Mcap(files[-1]))
    if rerun:
        from fivebar.twin.exporting.rerun import Writer as Rerun

        files.append(folder / f"{record.stem}.rrd")
        writers.append(Rerun(files[-1]))
    written = work.write(record, machine, *writers)
    refused = f"; {written.refused} rows are not valid messages and are left out" if written.refused else ""
    click.echo(f"{written.messages} messages{refused}")
    options.written(files)
    return 0
