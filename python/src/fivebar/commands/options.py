"""Options that several subcommands share."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fivebar.commands import completion

if TYPE_CHECKING:
    from fivebar.kinematics import Working

FILE = click.Path(path_type=Path)
"""A file or folder; who reads or makes it says what is wrong with it."""

SCENE = completion.Scene()

POSITIVE = click.FloatRange(min=0, min_open=True)

WORKING_MODES: "dict[str, Working]" = {
    "minusPlus": ("minus", "plus"),
    "minusMinus": ("minus", "minus"),
    "plusPlus": ("plus", "plus"),
    "plusMinus": ("plus", "minus"),
}
"""Working modes by the names that the unit has for them."""

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def fmu() -> Decorator:
    """The unit that is run."""
    return click.option("--fmu", type=FILE, metavar="FILE", help="Another unit than the shipped one.")


def learn() -> Decorator:
    """Whether a twin learns."""
    return click.option(
        "--learn", is_flag=True, help="Learn masses, payload, friction, lengths and mounting angles while following."
    )


def remote() -> Decorator:
    """How a process identifies itself to a broker, and the broker to it."""
    user = click.option("--user", default="", help="At that broker; its password is read from FIVEBAR_PASSWORD.")
    ca_file = click.option(
        "--ca-file",
        default="",
        metavar="FILE",
        help="Certificates for TLS with that broker; `system` for those of the system.",
    )
    return lambda command: user(ca_file(command))


def exact() -> Decorator:
    """Whether a machine is as long as its twin believes."""
    return click.option(
        "--exact", is_flag=True, help="Lengths and encoders are as the scene says, and the twin takes them so."
    )


def out(default: str) -> Decorator:
    """Option for the folder of the results."""
    return click.option(
        "--out", "-o", type=FILE, metavar="DIR", help=f"Folder for everything that is written; {default} unless told."
    )


def mode(multiple: bool) -> Decorator:
    """Working modes, or one of them."""
    words = (
        "A working mode, once or more; all four unless told."
        if multiple
        else "Working mode; that of the scene's start unless told."
    )
    return click.option("--mode", type=click.Choice(list(WORKING_MODES)), multiple=multiple, help=words)


def torque() -> Decorator:
    """Limits of the motors' torques."""
    words = "Limits of the motors' torques, N·m; those of the scene's servos unless told."
    return click.option("--torque", type=(POSITIVE, POSITIVE), metavar="LEFT RIGHT", help=words)


def check_folder(out: Path) -> None:
    """Refuses a folder for results that cannot be made, by making it and, where it was missing, taking it away again."""
    from fivebar.errors import FiveBarError

    missing = [folder for folder in (out, *out.parents) if not folder.exists()]
    try:
        out.mkdir(parents=True, exist_ok=True)
        for folder in missing:
            folder.rmdir()
    except OSError as error:
        raise FiveBarError(f"out is {out}; a folder that is there or can be made is needed: {error.strerror}") from None


def written(files: Iterable[Path]) -> None:
    """Says which files there are now."""
    click.echo("\nWritten:")
    for file in files:
        click.echo(f"  {_shown(file)}  ({_size(file.stat().st_size)})")


def show(file: Path | None, what: str, maker: str, no_open: bool) -> None:
    """Says where a shipped page is, and opens it unless `no_open`.

    Raises FiveBarError if the package comes without it; `cargo xtask MAKER` makes it.
    """
    import webbrowser

    from fivebar.errors import FiveBarError

    if file is None:
        raise FiveBarError(f"this package comes without the {what}; in a checkout `cargo xtask {maker}` makes it")
    click.echo(file)
    if not no_open:
        webbrowser.open(file.resolve().as_uri())


def _shown(file: Path) -> Path:
    """`file` as seen from the current directory, if it lies inside."""
    file, here = file.resolve(), Path.cwd().resolve()
    return file.relative_to(here) if file.is_relative_to(here) else file


def _size(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{max(size / 1e3, 0.1):.1f} kB"


def need(extra: str) -> None:
    """Refuses a subcommand whose packages are missing."""
    from fivebar import extras

    extras.need(extra)


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
