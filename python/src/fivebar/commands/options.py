"""Options that several subcommands share."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

FILE = click.Path(path_type=Path)
"""A file or folder; who reads or makes it says what is wrong with it."""

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def fmu() -> Decorator:
    """The unit that is run."""
    return click.option("--fmu", type=FILE, metavar="FILE", help="Another unit than the shipped one.")


def out(default: str) -> Decorator:
    """Option for the folder of the results."""
    return click.option("--out", "-o", type=FILE, metavar="DIR", help=f"Folder for everything that is written; {default} unless told.")


def need(extra: str) -> None:
    """Refuses a subcommand whose packages are missing."""
    from fivebar import extras

    extras.need(extra, f"`{click.get_current_context().command_path}`")


def assignments(given: tuple[str, ...]) -> dict[str, Any]:
    """`NAME=VALUE` as a mapping: numbers, true and false as in JSON, everything else a word."""
    found: dict[str, Any] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise click.UsageError(f"--set {text!r:.80} is not of the form NAME=VALUE")
        try:
            read = json.loads(value)
        except ValueError:
            read = value
        found[name] = value if isinstance(read, (dict, list, type(None))) else read
    return found
