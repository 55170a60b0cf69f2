"""`fivebar scenes`: lists the shipped scenes."""

import json

import click


@click.command()
@click.option(
    "--schema", is_flag=True, help="Print the JSON Schema of scene files instead: editors use it to complete names."
)
def scenes(schema: bool) -> None:
    """List the shipped scenes.

    `fivebar run`, `fivebar twin` and other commands take these names. A file of your own may set the same start values.
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
