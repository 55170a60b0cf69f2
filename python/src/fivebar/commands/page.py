"""`fivebar page`: the live page."""

import webbrowser

import click


@click.command()
@click.option("--no-open", is_flag=True, help="Only say where the page is.")
def page(no_open: bool) -> None:
    """Open the live page: drag the machine in the browser.

    The page computes by the unit's own code. It is one file that needs no network; send it to whom you like.
    """
    from fivebar import shipped
    from fivebar.errors import FiveBarError

    file = shipped.page()
    if file is None:
        raise FiveBarError("this package comes without the live page; in a checkout `cargo xtask page` makes it")
    click.echo(file)
    if not no_open:
        webbrowser.open(file.resolve().as_uri())
