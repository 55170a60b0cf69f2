"""The command `fivebar`: one module of this folder per subcommand.

At their top the modules import only click and modules of this folder. Packages that compute or draw, or that may be missing, are imported by
the function of the called command. Exit codes: 0: done; 1: done with a bad outcome (a step failed, a record differs), or an error of this
program; 2: the request is refused. Errors are one sentence on standard error.
"""

import os
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from fivebar.commands import (
    calibrate,
    check,
    docs,
    ensemble,
    export,
    import_,
    load,
    map,
    page,
    path,
    replay,
    run,
    scenes,
    soak,
    twin,
    unit,
    validate,
    what_if,
)
from fivebar.errors import FiveBarError, MachineWarning

COMMANDS = (
    run.run,
    scenes.scenes,
    unit.unit,
    map.map_,
    path.path,
    page.page,
    docs.docs,
    twin.twin,
    replay.replay,
    check.check,
    import_.import_,
    validate.validate,
    calibrate.calibrate,
    ensemble.ensemble,
    what_if.what_if,
    export.export,
    soak.soak,
    load.load,
)
"""Subcommands in the order of the help."""


class InOrder(click.Group):
    """Lists subcommands in the order of `COMMANDS`, which begins with those for newcomers."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


@click.group(cls=InOrder, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120})
@click.version_option(package_name="fivebar", message="fivebar %(version)s")
def fivebar() -> None:
    """The planar five-bar: run scenes, make units for your tool, follow a machine.

    \b
    fivebar run fall_90_120 --open     run a scene and watch it in the browser
    fivebar scenes                     list the scenes
    fivebar unit                       FiveBar.fmu for your own master
    """


for command in COMMANDS:
    fivebar.add_command(command)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a subcommand and returns its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    name = " ".join(["fivebar", *(part for part in given[:1] if part in fivebar.commands)])
    _keep_to_the_cache()
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warning(name)
            return int(fivebar.main(given, prog_name="fivebar", standalone_mode=False) or 0)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return 2
    except click.ClickException as error:
        sentence = " ".join(error.format_message().split()).rstrip(".")
        return _refused(name, f"{sentence}; `{name} --help` shows the usage")
    except FiveBarError as error:
        return _refused(name, str(error))
    except (click.Abort, KeyboardInterrupt):
        return 130
    except BrokenPipeError:
        # The reader of the output has closed the pipe; the rest of the buffer is dropped.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        # Refused by the system: a folder is a file, a disk is full, a port is taken.
        where = " ".join(str(part) for part in (error.filename, error.filename2) if part is not None)
        return _refused(name, f"{where or 'the system'}: {error.strerror or error}")
    except Exception as error:
        if os.environ.get("FIVEBAR_TRACEBACK"):
            raise
        sentence = " ".join(f"{type(error).__name__}: {error}".split())
        print(f"{name}: an error of this program, {sentence}; FIVEBAR_TRACEBACK=1 shows the traceback", file=sys.stderr)
        return 1


def _keep_to_the_cache() -> None:
    """Makes matplotlib draw to files, and lets packages without settings of the user write to the cache instead of the home folder."""
    # Pictures go to files.
    os.environ.setdefault("MPLBACKEND", "Agg")
    settings = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
    for variable, package, own in (
        ("MPLCONFIGDIR", "matplotlib", Path.home() / ".matplotlib"),
        ("DASK_CONFIG", "dask", Path.home() / ".dask"),
    ):
        if not (settings / package).exists() and not own.exists():
            os.environ.setdefault(variable, str(_cache() / package))


def _cache() -> Path:
    """The cache folder of the user."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "fivebar"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "fivebar"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fivebar"


def _warning(name: str) -> Callable[..., None]:
    """Prints warnings about machines as one sentence, all others as Python does."""
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, MachineWarning):
            print(f"{name}: warning: {message}", file=sys.stderr)
        else:
            usual(message, category, *where, **more)

    return show


def _refused(name: str, sentence: str) -> int:
    print(f"{name}: {sentence}", file=sys.stderr)
    return 2
