"""`fivebar docs`: the documentation."""

import click

from fivebar.commands import options


@click.command()
@click.option("--no-open", is_flag=True, help="Only say where the documentation is.")
def docs(no_open: bool) -> None:
    """Open the documentation of this version.

    Tutorials, how-to, reference and theory: a site in a folder that needs no network and no server.
    """
    from fivebar import shipped

    options.show(shipped.site(), "documentation", "site", no_open)
