"""Writes times and work of fixed steps, measured by `cargo xtask bench`, into the docs of the conserving method.

python step_times_in_docs.py --folder target/bench
"""

import argparse
import sys
from pathlib import Path

import matplotlib.pyplot as plt

from fivebar.drawing import STYLE
from report import docs, more_figures
from report.tables import Row, read

ROOT = Path(__file__).resolve().parents[2]
NOTES = "docs/notes/conserving.md"
MARKS = docs.marks("bounded work", "cargo xtask bench")
"""Comments around the table."""

STEPS = 10_000_000
"""Steps of the first setting in a full measurement."""


def main(arguments: list[str] | None = None) -> int:
    """Exit code 0: done, 1: no tables, or only of a sample."""
    parser = argparse.ArgumentParser(description="Writes times and work of strictly fixed steps into the docs.")
    parser.add_argument("--folder", type=Path, required=True, help="the folder of step-times.csv and step-work.csv")
    with plt.rc_context(STYLE):
        refused = update(ROOT, parser.parse_args(arguments).folder)
    print(refused or NOTES, file=sys.stderr if refused else sys.stdout)
    return 1 if refused else 0


def update(root: Path, folder: Path) -> str:
    """Writes the picture and the table; returns the reason if they are not fit for the docs."""
    times, work = (read(folder / f"{name}.csv").rows for name in ("step-times", "step-work"))
    if not (times and work and int(work[0]["steps"]) == STEPS):
        return f"{NOTES} stays as it is, for tables are missing or of a sample; `cargo xtask bench` measures all."
    docs.figure(root, "step-times", more_figures.histogram(times))
    docs.write(root, NOTES, MARKS, table(work))
    return ""


def table(rows: list[Row]) -> list[str]:
    """Iterations of a step, and how many of a million steps need more than a first guess."""
    head = [
        "step",
        "`solver.maxWork`",
        "median",
        "99.99 %",
        "most iterations",
        "rescued",
        "by the fallback",
        "ended with a status",
    ]
    lines = []
    for row in rows:
        counts = (f"{1e6 * int(row[name]) / int(row['steps']):.3g}" for name in ("rescued", "by the fallback", "ended"))
        iterations = (row[name] for name in ("median", "99.99 %", "most iterations"))
        lines.append([f"{1e3 * float(row['step [s]']):g} ms", f"{int(row['solver.maxWork']):,}", *iterations, *counts])
    return docs.markdown(head, lines, left=1)


if __name__ == "__main__":
    sys.exit(main())
