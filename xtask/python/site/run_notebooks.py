"""Runs the notebooks of examples/ and stores their outputs in them, and the picture of a notebook that README shows in docs/images/;
`cargo xtask site --notebooks`. The same code gives the same bytes.
"""

import shutil
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from notebook_picture import saving

REPOSITORY = Path(__file__).parents[3]

EXAMPLES = REPOSITORY / "examples"

LARGEST = 300_000
"""Size limit of a notebook with its outputs, bytes."""


def main() -> None:
    """All notebooks, one after the other."""
    for file in sorted(EXAMPLES.glob("*.ipynb")):
        notebook = run(file)
        text = nbformat.writes(notebook, indent=1) + "\n"
        if len(text.encode()) > LARGEST:
            raise SystemExit(
                f"{file.name} with its outputs has {len(text.encode())} bytes, which must be at most {LARGEST}"
            )
        file.write_text(text, encoding="utf-8")
        print(f"{file.name}: {len(text.encode())} bytes")


def run(file: Path) -> nbformat.NotebookNode:
    """The notebook with new outputs, run in a folder of its own that has the other files of examples/. An error in a cell is an error here."""
    notebook = nbformat.read(file, as_version=4)
    sources = [cell.source for cell in notebook.cells]
    for cell in notebook.cells:
        if "picture" in cell.metadata:
            cell.source += saving(str(REPOSITORY / cell.metadata["picture"]))
    with tempfile.TemporaryDirectory() as folder:
        for drawing in EXAMPLES.glob("*.svg"):
            shutil.copy(drawing, folder)
        NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": folder}}).execute()
    for cell, source in zip(notebook.cells, sources, strict=True):
        cell.source = source
        # Times of the run would differ in each.
        cell.metadata.pop("execution", None)
        for output in cell.get("outputs", ()):
            # The page shows pictures with the words of the cell, and other results as text.
            output.get("data", {}).pop("text/html", None)
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    return notebook


if __name__ == "__main__":
    main()
