"""The main table and picture in docs/accuracy.md, and the table of ratios in docs/notes/automatic.md, between comments."""

from pathlib import Path

BEGIN = "<!-- accuracy: what follows is written by `cargo xtask report --update-docs`, not by hand -->"
END = "<!-- accuracy: end -->"

RATIOS = ("<!-- ratios: what follows is written by `cargo xtask report --update-docs`, not by hand -->", "<!-- ratios: end -->")
"""Marks of the table of ratios in docs/notes/automatic.md."""

FILE, PICTURE = "docs/accuracy.md", "images/accuracy.svg"
"""The page of the main table, and where it sees the picture."""

CAPTION = "Error of the tip against time on one core, by method, for one scene of each kind"


def block(text: str, name: str, marks: tuple[str, str] = (BEGIN, END)) -> str:
    """The text between the comments of `text`."""
    begin, end = marks
    if text.count(begin) != 1 or text.count(end) != 1:
        raise ValueError(f"{name} must have the lines `{begin}` and `{end}` once each")
    return text.split(begin)[1].split(end)[0]


def table_of(text: str, name: str) -> list[str]:
    """The lines of the table between the comments."""
    return [line for line in block(text, name).splitlines() if line.startswith("|")]


def update(root: Path, table: list[str], ratios: list[str], about: str) -> None:
    """Writes the table and the link to the picture into their page, and the ratios into theirs."""
    write(root, FILE, (BEGIN, END), [f"![{CAPTION}]({PICTURE})", "", *table, "", f"Measured on: {about}"])
    write(root, "docs/notes/automatic.md", RATIOS, [*ratios, "", f"Measured on: {about}"])


def write(root: Path, name: str, marks: tuple[str, str], lines: list[str]) -> None:
    """Writes lines between the comments of a file."""
    file = root / name
    text = file.read_text(encoding="utf-8")
    block(text, name, marks)  # refuses a file without the marks
    begin, end = marks
    new = "\n".join(["", *lines, ""])
    file.write_text(text.split(begin)[0] + begin + new + end + text.split(end)[1], encoding="utf-8", newline="\n")
