"""Writes tables and pictures into the docs, tables between comments. The report writes the main table in docs/accuracy.md and the table of
ratios in docs/notes/automatic.md."""

import io
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from report.page import compact


def marks(name: str, command: str) -> tuple[str, str]:
    """Comments around a generated text."""
    return (
        f"<!-- {name}: what follows is written by `{command} --update-docs`, not by hand -->",
        f"<!-- {name}: end -->",
    )


BEGIN, END = marks("accuracy", "cargo xtask report")
"""Marks of the main table."""

RATIOS = marks("ratios", "cargo xtask report")
"""Marks of the table of ratios."""

FILE, PICTURE = "docs/accuracy.md", "images/accuracy.svg"
"""Page of the main table, and path of the picture relative to it."""

CAPTION = "Error of the tip against time on one core, by method, for one scene of each kind"


def block(text: str, name: str, marks: tuple[str, str] = (BEGIN, END)) -> str:
    """The part of `text` between the comments."""
    begin, end = marks
    if text.count(begin) != 1 or text.count(end) != 1:
        raise ValueError(f"{name} must have the lines `{begin}` and `{end}` once each")
    return text.split(begin)[1].split(end)[0]


def table_of(text: str, name: str, marks: tuple[str, str] = (BEGIN, END)) -> list[str]:
    """Lines of the table between the comments."""
    return [line for line in block(text, name, marks).splitlines() if line.startswith("|")]


def update(root: Path, table: list[str], ratios: list[str], about: str) -> None:
    """Writes table and picture link into their page, and the ratios into theirs."""
    write(root, FILE, (BEGIN, END), [f"![{CAPTION}]({PICTURE})", "", *table, "", f"Measured on: {about}"])
    write(root, "docs/notes/automatic.md", RATIOS, [*ratios, "", f"Measured on: {about}"])


def markdown(head: list[str], lines: list[list[str]], left: int) -> list[str]:
    """Lines of a Markdown table; columns after the first `left` are aligned right."""
    rule = ["---"] * left + ["---:"] * (len(head) - left)
    return [f"| {' | '.join(line)} |" for line in (head, rule, *lines)]


def figure(root: Path, name: str, drawn: Figure) -> None:
    """Writes a figure to docs/images, and closes it."""
    drawing = io.StringIO()
    with plt.rc_context({"svg.hashsalt": name}):
        drawn.savefig(drawing, format="svg", metadata={"Date": None})
    plt.close(drawn)
    picture(root, name, drawing.getvalue())


def picture(root: Path, name: str, drawing: str) -> None:
    """Writes an SVG, given as text, to docs/images."""
    (root / f"docs/images/{name}.svg").write_text(compact(drawing), encoding="utf-8", newline="\n")


def write(root: Path, name: str, marks: tuple[str, str], lines: list[str]) -> None:
    """Writes lines between the comments of a file."""
    file = root / name
    text = file.read_text(encoding="utf-8")
    block(text, name, marks)  # fails if the file lacks the marks
    begin, end = marks
    new = "\n".join(["", *lines, ""])
    file.write_text(text.split(begin)[0] + begin + new + end + text.split(end)[1], encoding="utf-8", newline="\n")
