"""`fivebar docs`: the documentation."""

import webbrowser

import click


@click.command()
@click.option("--no-open", is_flag=True, help="Only say where the documentation is.")
def docs(no_open: bool) -> None:
    """Open the documentation of this version.

    Tutorials, how-to, reference and theory: a site in a folder that needs no network and no server.
    """
    from fivebar import shipped
    from fivebar.errors import FiveBarError

    file = shipped.site()
    if file is None:
        raise FiveBarError("this package comes without the documentation; in a checkout `cargo xtask site` makes it")
    click.echo(file)
    if not no_open:
        webbrowser.open(file.resolve().as_uri())
