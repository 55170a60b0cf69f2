"""The console command `fivebar-twin`: one subcommand per module, which is loaded only when it is asked for."""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import NamedTuple

from fivebar.twin.errors import TwinError


class Command(NamedTuple):
    """A subcommand: a module with `arguments(parser)` and `run(arguments) -> exit code`."""

    module: str
    help: str


COMMANDS = {
    "run": Command("starter", "run the whole pipeline for some seconds, write summary, pictures and page"),
    "replay": Command("replay", "compute the estimates of a record again and compare them to the bit"),
    "calibrate": Command("calibrate.command", "what the machine is, from a record: masses, friction, lengths, offsets with error bars"),
    "ensemble": Command("ensemble.command", "many runs that differ as much as one does not know, on Dask"),
    "what-if": Command("ensemble.what_if", "what some commands would lead to from the running twin's state; ranked, publishes whatif"),
    "load": Command("load", "how many machines a broker carries"),
    "soak": Command("soak", "hours of samples without broker and clock: nothing lost, nothing grows"),
    "broker": Command("broker", "the broker that comes along, on the loopback interface"),
    "machine": Command("machine", "the machine's stand-in, or a recorded CSV: publishes meas"),
    "follow": Command("follow", "the twin: takes meas, param and cmd, publishes est"),
    "forecast": Command("ahead", "goes ahead of the twin: publishes forecast"),
    "record": Command("recorder", "everything that is published, into Parquet"),
    "watch": Command("watch", "anomalies: publishes alarm"),
    "dashboard": Command("dashboard", "the page that shows machine and twin live"),
}
"""By name; the processes of a run are subcommands too."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a subcommand; an error on the user's side is one sentence and exit code 2."""
    parser = argparse.ArgumentParser(prog="fivebar-twin", description="The live twin of a five-bar.")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    given = list(sys.argv[1:] if argv is None else argv)
    for name, command in COMMANDS.items():
        subparser = subparsers.add_parser(name, help=command.help, description=command.help[0].upper() + command.help[1:] + ".")
        # Only the module of the command that is asked for: processes start at once, and without the packages of others.
        if given[:1] == [name]:
            import_module(f"fivebar.twin.{command.module}").arguments(subparser)
    arguments = parser.parse_args(given)
    try:
        return import_module(f"fivebar.twin.{COMMANDS[arguments.command].module}").run(arguments)
    except TwinError as error:
        print(f"fivebar-twin {arguments.command}: {error}", file=sys.stderr)
    except OSError as error:
        # The system refuses: a folder is a file, a disk is full, a port is taken.
        where = " ".join(str(name) for name in (error.filename, error.filename2) if name is not None)
        print(f"fivebar-twin {arguments.command}: {where or 'the system'}: {error.strerror or error}", file=sys.stderr)
    except KeyboardInterrupt:
        return 130
    return 2
