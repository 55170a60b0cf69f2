"""`fivebar load`: how many machines a broker carries."""

import click

from fivebar.commands import options


@click.command()
@click.option("--broker", metavar="HOST:PORT", help="An MQTT broker on this machine; default: the included one.")
@click.option(
    "--seconds",
    type=float,
    default=4.0,
    show_default=True,
    metavar="S",
    help="Duration for each number of machines, s.",
)
@click.option("--most", type=int, default=64, show_default=True, metavar="N", help="Maximum number of machines.")
def load(broker: str | None, seconds: float, most: int) -> int:
    """Measure how many machines a broker carries.

    Doubles the number of machines that publish 200 samples a second until messages are late or lost.
    """
    options.need("twin")
    from fivebar.twin import load as work

    return work.run(broker, seconds, most)
