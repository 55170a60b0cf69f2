"""The processes of a twin: `python -m fivebar.twin NAME --config FILE`. `fivebar twin` starts them all."""

import sys
from importlib import import_module
from pathlib import Path

from fivebar.errors import FiveBarError

PROCESSES = {
    "broker": "broker",
    "machine": "machine",
    "follow": "follow",
    "forecast": "ahead",
    "record": "recorder",
    "watch": "watch",
    "dashboard": "dashboard",
}
"""Module of each process by name; docs/pipeline.md describes the processes."""


def main() -> int:
    """Runs one process until it is asked to stop."""
    # Parsed by hand, and only the module of this process is imported: a fast start, without the packages of other processes.
    match sys.argv[1:]:
        case [name, "--config", file] if name in PROCESSES:
            pass
        case _:
            print(
                f"python -m fivebar.twin NAME --config FILE, where NAME is one of {', '.join(PROCESSES)}",
                file=sys.stderr,
            )
            return 2
    try:
        return int(import_module(f"fivebar.twin.{PROCESSES[name]}").run(Path(file)))
    except FiveBarError as error:
        print(f"{name}: {error}", file=sys.stderr)
    except OSError as error:
        print(f"{name}: {error.filename or 'the system'}: {error.strerror or error}", file=sys.stderr)
    except KeyboardInterrupt:
        return 130
    return 2


if __name__ == "__main__":
    sys.exit(main())
