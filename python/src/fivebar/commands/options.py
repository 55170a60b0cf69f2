"""Options that several subcommands share."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fivebar.commands import completion

if TYPE_CHECKING:
    from fivebar.kinematics import Working


class File(click.Path):
    """A path that is not the empty text, which would be the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("'' names no file or folder", param, ctx)
        return super().convert(value, param, ctx)


FILE = File(path_type=Path)
"""A file or folder; the function that reads or writes it reports errors."""

SCENE = completion.Scene()

POSITIVE = click.FloatRange(min=0, min_open=True)

WORKING_MODES: "dict[str, Working]" = {
    "minusPlus": ("minus", "plus"),
    "minusMinus": ("minus", "minus"),
    "plusPlus": ("plus", "plus"),
    "plusMinus": ("plus", "minus"),
}
"""Working modes by the unit's names."""

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def fmu() -> Decorator:
    """Option for another unit."""
    return click.option("--fmu", type=FILE, metavar="FILE", help="Another unit than the shipped one.")


def learn() -> Decorator:
    """Option to let a twin learn."""
    return click.option(
        "--learn", is_flag=True, help="Learn masses, payload, friction, lengths and mounting angles while following."
    )


def remote() -> Decorator:
    """Options for user, password and certificates of a remote broker."""
    user = click.option(
        "--user", default="", help="User name at the broker; the password is read from FIVEBAR_PASSWORD."
    )
    ca_file = click.option(
        "--ca-file",
        default="",
        metavar="FILE",
        help="Certificates for TLS with the broker; `system` uses the system's certificates.",
    )
    return lambda command: user(ca_file(command))


def exact() -> Decorator:
    """Option for exact lengths and encoders."""
    return click.option(
        "--exact", is_flag=True, help="Lengths and encoders are exactly as in the scene, and the twin assumes so."
    )


def out(default: str) -> Decorator:
    """Option for the folder of the results."""
    return click.option(
        "--out", "-o", type=FILE, metavar="DIR", help=f"Folder for all written files; default: {default}."
    )


def mode(multiple: bool) -> Decorator:
    """Option for one working mode or several."""
    words = (
        "A working mode; may be repeated; default: all four."
        if multiple
        else "Working mode; default: the mode at the scene's start."
    )
    return click.option("--mode", type=click.Choice(list(WORKING_MODES)), multiple=multiple, help=words)


def torque() -> Decorator:
    """Option for torque limits of the motors."""
    words = "Torque limits of the motors, N·m; default: the limits of the scene's servos."
    return click.option("--torque", type=(POSITIVE, POSITIVE), metavar="LEFT RIGHT", help=words)


def check_folder(out: Path) -> None:
    """Checks that a folder for results can be made: makes it and, if it was missing, removes it again."""
    from fivebar.errors import FiveBarError

    missing = [folder for folder in (out, *out.parents) if not folder.exists()]
    try:
        out.mkdir(parents=True, exist_ok=True)
        for folder in missing:
            folder.rmdir()
    except OSError as error:
        raise FiveBarError(f"out is {out}; a folder that exists or can be made is needed: {error.strerror}") from None


def written(files: Iterable[Path]) -> None:
    """Lists the written files."""
    click.echo("\nWritten:")
    for file in files:
        click.echo(f"  {_shown(file)}  ({_size(file.stat().st_size)})")


def show(file: Path | None, what: str, maker: str, no_open: bool) -> None:
    """Prints the path of a shipped page, and opens it unless `no_open`.

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
    """`file` relative to the current directory, if it is inside."""
    file, here = file.resolve(), Path.cwd().resolve()
    return file.relative_to(here) if file.is_relative_to(here) else file


def _size(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{max(size / 1e3, 0.1):.1f} kB"


def need(extra: str) -> None:
    """Refuses the subcommand if packages of its extra are missing."""
    from fivebar import extras

    extras.need(extra)


def assignments(given: tuple[str, ...]) -> dict[str, Any]:
    """Parses `NAME=VALUE` arguments: numbers, true and false as in JSON, everything else as text."""
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
