"""Writes the tables of `cargo xtask peers` into docs/notes/peers.md.

python peers_in_docs.py --peers target/peers
"""

import argparse
import sys
from pathlib import Path

from peers import ahead
from report import docs, tables

ROOT = Path(__file__).resolve().parents[2]
FILE = "docs/notes/peers.md"
COMMAND = "cargo xtask peers"
"""The table's head ends with it if all peers ran; otherwise names follow."""

AHEAD, ENERGIES = (docs.marks(name, COMMAND) for name in ("peers", "peers' energies"))
"""Comments around the generated text."""

SECOND = 1
"""Time at which errors are compared, s."""


def main(arguments: list[str] | None = None) -> int:
    """Exit code 0: done, 1: no table, or peers are missing."""
    parser = argparse.ArgumentParser(description="Writes the tables of the peers into docs/notes/peers.md.")
    parser.add_argument("--peers", type=Path, required=True, help="the folder of peers.csv")
    options = parser.parse_args(arguments)
    found = tables.read(options.peers / "peers.csv")
    if not found:
        print(f"There is no table in {options.peers}; `cargo xtask peers` measures it.", file=sys.stderr)
        return 1
    if missing := left_out(found):
        print(
            f"The docs stay as they are, for the table has no {missing}; `.ci/setup-peers` and `cargo xtask peers` have all.",
            file=sys.stderr,
        )
        return 1
    update(ROOT, found.rows, found.about)
    print(FILE)
    return 0


def left_out(found: tables.Table) -> str:
    """Names of peers that did not run; empty if all did."""
    of_some = found.about.partition(f"{COMMAND} ")[2] if COMMAND in found.about else found.about
    return ", ".join([row["peer"] for row in found.rows if not row["scene"]]) or (
        f"others than {of_some}" if of_some else ""
    )


def update(root: Path, rows: list[ahead.Row], about: str) -> None:
    """Writes one table per scene and the table of energies between their comments."""
    measured, lines = f"Measured on: {about}", []
    for scene in ahead.SCENES:
        shown = ahead.markdown(ahead.cells(ahead.table(rows, scene, SECOND)))
        lines += [f"[`{scene}`](../../scenes/{scene}.json), after {SECOND} s:", ""]
        lines += [*(line.replace("solver.errorTolerance = ", "") for line in shown), ""]
    docs.write(root, FILE, AHEAD, [*lines, measured])
    docs.write(root, FILE, ENERGIES, [*ahead.markdown(ahead.energies(rows)), "", measured])


if __name__ == "__main__":
    sys.exit(main())
