"""`fivebar scenes`: what there is to run."""

import json

import click


@click.command()
@click.option(
    "--schema", is_flag=True, help="Print the JSON Schema of scene files instead: editors complete names by it."
)
def scenes(schema: bool) -> None:
    """List the shipped scenes.

    Each is a name for `fivebar run`, `fivebar twin` and the others, and begins from start values that a file of your own can have too.
    """
    import fivebar

    if schema:
        from fivebar import scene_schema
        from fivebar.variables import of_unit

        click.echo(json.dumps(scene_schema.schema(of_unit()), indent=2, ensure_ascii=False))
        return
    listed = fivebar.scenes()
    width = max(map(len, listed), default=0)
    for name, description in listed.items():
        click.echo(f"{name:{width}}  {description}")
