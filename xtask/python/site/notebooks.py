"""Notebooks as pages: text, code, and the outputs that are stored in them."""

import base64
import json
from pathlib import Path
from typing import Any

KINDS = {"image/svg+xml": "svg", "image/png": "png"}
"""Pictures among outputs, best first."""


def page(notebook: Path) -> dict[str, str | bytes]:
    """The page of a notebook and its pictures, by name."""
    files: dict[str, str | bytes] = {}
    parts: list[str] = []
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(text)
            # The first cell has the title.
            if len(parts) == 1:
                parts.append(f"[`{notebook.name}`]({notebook.name}) is this page as a notebook.")
                files[notebook.name] = notebook.read_bytes()
            continue
        parts.append(f"```python\n{text}\n```")
        parts += [_shown(output, notebook.stem, files, cell["metadata"].get("alt", "")) for output in cell["outputs"]]
    return files | {f"{notebook.stem}.md": "\n\n".join(parts) + "\n"}


def _shown(output: dict[str, Any], stem: str, files: dict[str, str | bytes], alt: str) -> str:
    """An output as Markdown; a picture becomes a file, and its words are those of the cell."""
    if output["output_type"] == "stream":
        return _text("".join(output["text"]))
    data = output["data"]
    for kind, ending in KINDS.items():
        if kind in data:
            name = f"{stem}-{len(files)}.{ending}"
            content = "".join(data[kind])
            files[name] = content if ending == "svg" else base64.b64decode(content)
            return f"![{alt}]({name})"
    return _text("".join(data["text/plain"]))


def _text(text: str) -> str:
    return f"```text\n{text.rstrip()}\n```"
