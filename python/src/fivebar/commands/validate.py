"""`fivebar validate`: how well the twin predicts a recording."""

from pathlib import Path

import click

from fivebar.commands import options


@click.command()
@click.argument("record", type=options.FILE)
@click.option(
    "--scene",
    type=options.SCENE,
    required=True,
    metavar="SCENE|FILE",
    help="The machine, with its known parameters and encoders.",
)
@click.option(
    "--known-commands", is_flag=True, help="Forecasts know the later commands of the record, as a planner does."
)
@options.fmu()
@options.out("./validate/")
def validate(record: Path, scene: str, known_commands: bool, fmu: Path | None, out: Path | None) -> int:
    """Judge the twin on a recording of a machine.

    RECORD is a table (CSV or Parquet) with time (s), measured.theta[1..2] (rad) and, as far as known, commands (servo.theta, servo.omega, tau) and the tip (tip.x, tip.y).
    The twin follows it; its last third is held out: innovations, forecasts and their bands are judged there, and compared with predictors without mechanics.
    If alarms are frequent or too few innovations are inside, and a larger estimator.torqueScale ends this, it is proposed.

    \b
    fivebar validate bench.csv --scene my_machine.json

    Exit code 1 if less than 90 % are inside the 95 % bands, if errors of forecasts of 0.1 s exceed 1.2 times those of the best other predictor, or if the machine was not followed.
    """
    options.need("twin")
    from fivebar import shipped
    from fivebar.twin import validate as work

    return work.run(work.Options(record, scene, fmu or shipped.unit(), out or Path("validate"), known_commands))
