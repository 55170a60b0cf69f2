"""`fivebar page`: the live page."""

import click

from fivebar.commands import options


@click.command()
@click.option("--no-open", is_flag=True, help="Only say where the page is.")
def page(no_open: bool) -> None:
    """Open the live page: drag the machine in the browser.

    The page computes by the unit's own code. It is one file that needs no network; send it to whom you like.
    """
    from fivebar import shipped

    options.show(shipped.page(), "live page", "page", no_open)
