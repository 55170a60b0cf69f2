"""`fivebar scenes`: what there is to run."""

import click


@click.command()
def scenes() -> None:
    """List the shipped scenes.

    Each is a name for `fivebar run`, `fivebar twin` and the others, and begins from start values that a file of your own can have too.
    """
    import fivebar

    listed = fivebar.scenes()
    width = max(map(len, listed), default=0)
    for name, description in listed.items():
        click.echo(f"{name:{width}}  {description}")
