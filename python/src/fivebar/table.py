"""Writes the samples of a run as CSV, in full precision, with the units in the header."""

from pathlib import Path

from fivebar.drive import Run


def write(path: Path, run: Run) -> None:
    """One row per communication point; `repr` gives back every bit of a double."""
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(f"{name} [{run.units[name]}]" for name in run.columns) + "\n")
        for row in zip(*(column.tolist() for column in run.columns.values())):
            file.write(",".join(map(repr, row)) + "\n")
