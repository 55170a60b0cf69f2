"""The main table and picture in README.md and docs/accuracy.md, between two comments."""

from pathlib import Path

BEGIN = "<!-- accuracy: what follows is written by `cargo xtask report --update-docs`, not by hand -->"
END = "<!-- accuracy: end -->"

FILES = {"README.md": "docs/images/accuracy.svg", "docs/accuracy.md": "images/accuracy.svg"}
"""The files, and where each sees the picture."""

CAPTION = "Error of the tip against time on one core, by method, for one scene of each kind"


def block(text: str, name: str) -> str:
    """What is between the comments of `text`."""
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise ValueError(f"{name} must have the lines `{BEGIN}` and `{END}` once each")
    return text.split(BEGIN)[1].split(END)[0]


def table_of(text: str, name: str) -> list[str]:
    """The lines of the table between the comments."""
    return [line for line in block(text, name).splitlines() if line.startswith("|")]


def update(root: Path, table: list[str], about: str) -> None:
    """Writes the table and the link to the picture into both files."""
    for name, picture in FILES.items():
        file = root / name
        text = file.read_text(encoding="utf-8")
        new = "\n".join(["", f"![{CAPTION}]({picture})", "", *table, "", f"Measured on: {about}", ""])
        block(text, name)  # refuses a file without the marks
        before, after = text.split(BEGIN)[0], text.split(END)[1]
        file.write_text(before + BEGIN + new + END + after, encoding="utf-8", newline="\n")
