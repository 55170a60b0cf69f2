"""`fivebar load`: what a broker carries."""

import click

from fivebar.commands import options


@click.command()
@click.option("--broker", metavar="HOST:PORT", help="Any MQTT broker of this machine; else the one that comes along.")
@click.option("--seconds", type=float, default=4.0, show_default=True, metavar="S", help="For each number of machines.")
@click.option("--most", type=int, default=64, show_default=True, metavar="N", help="Machines at most.")
def load(broker: str | None, seconds: float, most: int) -> int:
    """Measure how many machines a broker carries.

    Doubles the number of machines that publish 200 samples a second until messages are late or lost.
    """
    options.need("twin")
    from fivebar.twin import load as work

    return work.run(broker, seconds, most)
