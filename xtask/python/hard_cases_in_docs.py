"""Writes the tables and pictures of `cargo xtask hard-cases` into docs/hard-cases.md and its notes.

python hard_cases_in_docs.py --folder target/hard-cases
"""

import argparse
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from hard_cases import Row, read_rows
from report import docs

ROOT = Path(__file__).resolve().parents[2]
PAGE, NOTES = "docs/hard-cases.md", "docs/notes/hard-cases.md"
PICTURES = ("hard-cases", "horizon")

ITEMS, FALLS = 10, 1000
"""Number of items in the list, and of runs of the first case, in a full run."""

Column = tuple[str, ...]
"""A method and its settings; a case has one of them."""

DEFAULT, TIGHT = ("i3alp", "default tolerance", "own settings"), ("i3alp", "tolerance 3e-10 rad")
EXPLICIT, AUTOMATIC = ((method, "tolerance 1e-10 rad") for method in ("dop853", "automatic"))
CONSERVING = [("i3alpConserving", f"{step} ms") for step in ("0.25", "1", "4")]

Found = list[Row | None]
"""Rows of a case by columns; None if a column does not have the case."""

BARE = {
    "perturbed free falls of 50 s": ("perturbed free falls",),
    "exact crossings of a vertex": ("exact crossings",),
    "near misses": ("near misses",),
    "close misses": ("close misses",),
    "branch with one degree of freedom": ("branch with one degree of freedom",),
    "rest in a vertex, no load": ("rest in a vertex, no load",),
    "rest in a vertex under load": ("rest in a vertex under load",),
    "direct, inverse singularities": ("direct singularities", "inverse singularities"),
    "coaxial motors": ("coaxial motors", "coaxial motors, rest in line"),
    "paper test 1": ("paper test 1",),
    "lengths, masses, payload, steps of load": (
        "links of 0.02 to 2 m",
        "mass ratios of 1e-4 to 1e4",
        "payload of 1e3 links",
        "steps of load",
    ),
    "one hour": ("one hour",),
}
"""Rows of the table on the page: its cases, some grouped."""

FIRST = ["item", "case", "runs"]
ENERGY, POSITION, VELOCITY = "worst |dE| [mgL]", "worst Phi [m]", "worst Phidot [m/s]"
"""Columns of the battery's table."""

OTHERS = ("perturbed free falls", "exact crossings")
"""Cases with a table of methods that are not judged."""


def main(arguments: list[str] | None = None) -> int:
    """Exit code 0: done, 1: no table, or none fit for the docs."""
    parser = argparse.ArgumentParser(
        description="Writes the tables and pictures of the hard cases into docs/hard-cases.md and its notes."
    )
    parser.add_argument("--folder", type=Path, required=True, help="the folder of hard-cases.csv and the pictures")
    refused = update(ROOT, parser.parse_args(arguments).folder)
    print(refused or f"{PAGE}\n{NOTES}", file=sys.stderr if refused else sys.stdout)
    return 1 if refused else 0


def update(root: Path, folder: Path) -> str:
    """Writes tables and pictures; returns the reason if they are not fit for the docs."""
    try:
        rows = sorted(read_rows(folder / "hard-cases.csv"), key=lambda row: int(row["item"]))
        drawings = {name: (folder / f"{name}.svg").read_text(encoding="utf-8") for name in PICTURES}
        why = unfit(rows)
    except OSError as error:
        why = f"a table or picture is missing: {error}"
    if why:
        return f"{PAGE} stays as it is, for {why}; `cargo xtask hard-cases` makes all."
    for name, drawing in drawings.items():
        docs.picture(root, name, drawing)
    for (file, around), lines in texts(rows).items():
        docs.write(root, file, around, lines)
    return ""


def unfit(rows: list[Row]) -> str:
    """Reason not to show the rows; empty if all cases are present and none fails."""
    if missed := [f"{row['case']} by {row['method']}" for row in rows if row["verdict"] == "FAIL"]:
        return f"cases are not met: {', '.join(missed)}"
    if {row["item"] for row in rows} != {str(item) for item in range(1, ITEMS + 1)}:
        return "items are missing in the table"
    return "" if rows[0]["runs"] == str(FALLS) else "the table is of a sample"


def texts(rows: list[Row]) -> dict[tuple[str, tuple[str, str]], list[str]]:
    """Lines of the docs by file and marks."""
    bare = [row for row in rows if int(row["item"]) <= 7]
    found = {
        (PAGE, "bare machine"): bare_machine(bare),
        (NOTES, "default method"): default_method(bare),
        (NOTES, "explicit method"): explicit_method(bare),
        (NOTES, "conserving step"): conserving_step(bare),
        (NOTES, "discontinuities"): discontinuities([row for row in rows if row["item"] == "9"]),
        (NOTES, "others"): others(rows),
    }
    return {(file, marks(name)): lines for (file, name), lines in found.items()}


def marks(name: str) -> tuple[str, str]:
    """Comments around a table."""
    return docs.marks(name, "cargo xtask hard-cases")


def bare_machine(rows: list[Row]) -> list[str]:
    """Energy errors of the methods at one setting each, and constraint violation of `i3alp`."""
    shown = (DEFAULT, EXPLICIT, CONSERVING[1])
    lines = []
    for label, cases in BARE.items():
        columns = [by(column, [row for row in rows if row["case"] in cases]) for column in shown]
        runs = sum(int(row["runs"]) for row in columns[0])
        lines.append([columns[0][0]["item"], label, str(runs), *(worst(column, ENERGY) for column in columns)])
    adaptive = [row for row in by(DEFAULT, rows) + by(TIGHT, rows) if row["item"] != "7"]
    left = f"In items 1 to 6 `i3alp` leaves at most {worst(adaptive, POSITION)} m and {worst(adaptive, VELOCITY)} m/s of the constraints."
    return [*docs.markdown(["item", "case", "runs", *(f"`{name}`" for name, *_ in shown)], lines, left=2), "", left]


def default_method(rows: list[Row]) -> list[str]:
    """The cases by `i3alp` at its judged tolerances."""
    head = [*FIRST, "worst \\|ΔE\\| default, mgL", "tight, mgL", "worst Φ, m", "worst Φ̇, m/s", "ended early"]
    return docs.markdown(
        head,
        [
            [*first(found), *energies(found), *violations(found), early(found)]
            for found in by_case(rows, DEFAULT, TIGHT)
        ],
        left=2,
    )


def explicit_method(rows: list[Row]) -> list[str]:
    """The cases by `dop853`."""
    head = [*FIRST, "worst \\|ΔE\\|, mgL", "demand, mgL", "sub-steps per step"]
    lines = [
        [*first([row]), worst([row], ENERGY), demand(row), row["mean sub-steps"]] for [row] in by_case(rows, EXPLICIT)
    ]
    return docs.markdown(head, lines, left=2)


def conserving_step(rows: list[Row]) -> list[str]:
    """The cases by fixed steps of three lengths, the middle one judged; and the number of steps made by the fallback."""
    head = [
        *FIRST,
        "worst \\|ΔE\\| at 0.25 ms, mgL",
        "at 1 ms",
        "at 4 ms",
        "demand at 1 ms",
        "worst Φ, m",
        "worst Φ̇, m/s",
        "ended early",
        "by the fallback",
    ]
    lines = []
    for found in by_case(rows, *CONSERVING):
        lines.append(
            [
                *first(found),
                *energies(found),
                demand(found[1]),
                *violations(found),
                early(found),
                slashed(found, fallbacks),
            ]
        )
    return docs.markdown(head, lines, left=2)


def discontinuities(rows: list[Row]) -> list[str]:
    """Scenes of loads with discontinuities by the judged methods."""
    head = ["case", "`i3alp`", "`i3alp`, 3e-10 rad", "`dop853`", "`automatic`"]
    return docs.markdown(
        head,
        [[first(found)[1], *energies(found)] for found in by_case(rows, DEFAULT, TIGHT, EXPLICIT, AUTOMATIC)],
        left=1,
    )


def others(rows: list[Row]) -> list[str]:
    """Methods and settings that are not judged, in two of the cases."""
    head = ["case", "method", "step", "ended early", "not met", "of", "worst \\|ΔE\\| while it ran, mgL"]
    shown = [
        row
        for row in rows
        if row["case"] in OTHERS and row["verdict"] == "for comparison" and row["method"] != CONSERVING[0][0]
    ]
    names = ("case", "method", "setting", "ended early", "not met", "runs")
    return docs.markdown(head, [[*(row[name] for name in names), worst([row], ENERGY)] for row in shown], left=3)


def by(column: Column, rows: list[Row]) -> list[Row]:
    """The rows of a column."""
    method, *settings = column
    return [row for row in rows if row["method"] == method and row["setting"] in settings]


def by_case(rows: list[Row], *columns: Column) -> Iterator[Found]:
    """The rows of each case that at least one of the columns has."""
    for case in dict.fromkeys(row["case"] for row in rows):
        of_case = [row for row in rows if row["case"] == case]
        found = [next(iter(by(column, of_case)), None) for column in columns]
        if any(found):
            yield found


def first(found: Found) -> list[str]:
    """The cells of `FIRST`."""
    row = next(filter(None, found))
    return [row["item"], row["case"], row["runs"]]


def energies(found: Found) -> list[str]:
    """Worst energy error of each."""
    return [worst([row], ENERGY) for row in found]


def violations(found: Found) -> list[str]:
    """Worst violations over all."""
    return [worst(found, POSITION), worst(found, VELOCITY)]


def worst(found: Found, name: str) -> str:
    """The largest value of a column, as the battery writes it."""
    value = max((row[name] for row in found if row), key=float, default="")
    return "0" if value and float(value) == 0 else value


def demand(row: Row | None) -> str:
    """Allowed energy error, mgL."""
    return re.search(r"\|dE\| <= (\S+) mgL", row["criterion"])[1] if row else ""


def early(found: Found) -> str:
    """Number of runs that ended early."""
    return slashed(found, lambda row: row["ended early"])


def fallbacks(row: Row) -> str:
    """Number of steps made by the fallback of the conserving step."""
    counted = re.search(r"(\d+) x of \d+ steps by the fallback", row["status"])
    return counted[1] if counted else "0"


def slashed(found: Found, cell: Callable[[Row], str]) -> str:
    """Cells of several settings joined by slashes."""
    return " / ".join(cell(row) for row in found if row)


if __name__ == "__main__":
    sys.exit(main())
