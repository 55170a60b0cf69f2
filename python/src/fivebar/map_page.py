"""The map of a scene as one self-contained page: the template `map.html`, filled with the fields of each working mode. The
machine follows the pointer.
"""

import base64
import html
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fivebar.borders import REACH, outline, shown
from fivebar.colours import STYLE_SHEET
from fivebar.workspace import Map, Mode
from fivebar.workspace_pictures import KAPPAS, force_levels, load_words, scale_colours

TEMPLATE = Path(__file__).with_name("map.html")

MOST = 1e9
"""Forces, N, and margins, rad, are clipped to this magnitude: JSON has no infinity."""


def write(survey: Map, file: Path) -> Path:
    """Writes the page; returns the file."""
    machine, scene = survey.machine, survey.scene
    cell = float(survey.x[1] - survey.x[0])
    data = {
        "name": scene.name,
        "description": scene.description,
        "machine": {"distance": machine.distance, "lengths": machine.lengths},
        "outline": outline(machine),
        "grid": {
            "x": float(survey.x[0]),
            "y": float(survey.y[0]),
            "cell": cell,
            "columns": len(survey.x),
            "rows": len(survey.y),
        },
        "load": "" if survey.limits is None else load_words(survey),
        "modes": [_mode(survey, mode) for mode in survey.modes],
    }
    # "</" would end the script element with the data.
    packed = json.dumps(data, ensure_ascii=False, allow_nan=False).replace("</", "<\\/")
    page = TEMPLATE.read_text(encoding="utf-8")
    page = (
        page.replace("{{title}}", html.escape(scene.name))
        .replace("{{colours}}", STYLE_SHEET.read_text(encoding="utf-8"))
        .replace("{{reach}}", REACH.read_text(encoding="utf-8"))
        .replace("{{data}}", packed)
    )
    file.write_text(page, encoding="utf-8", newline="\n")
    return file


def _mode(survey: Map, mode: Mode) -> dict[str, Any]:
    machine, kappas = survey.machine, [f"{kappa:g}" if np.isfinite(kappa) else "∞" for kappa in KAPPAS]
    fields = [_field("condition number", "", mode.dexterity, [1 / kappa for kappa in KAPPAS], kappas)]
    if mode.force is not None and len(levels := force_levels(mode)):
        fields.append(
            _field(
                "force held in every direction", "N", mode.force, levels.tolist(), [f"{level:g}" for level in levels]
            )
        )
    parts = [] if survey.path is None else [survey.path.tip[part] for part in survey.path.parts(mode.working)]
    return {
        "name": mode.name,
        "bends": [1 if bend == "plus" else -1 for bend in mode.working],
        "fields": fields,
        "margin": _packed(mode.stop_margin) if np.isfinite(mode.stop_margin).any() else None,
        "stops": [shown(curve.tip, machine) for curve in mode.curves if curve.kind == "stop"],
        "discs": [disc._asdict() for disc in mode.discs if disc.radius > 0.3 * mode.discs[0].radius],
        "path": [shown(part, machine, 1) for part in parts],
    }


def _field(name: str, unit: str, values: NDArray[np.float64], levels: list[float], labels: list[str]) -> dict[str, Any]:
    """A field with one colour between each two levels."""
    return {
        "name": name,
        "unit": unit,
        "values": _packed(values),
        "levels": levels,
        "labels": labels,
        "colours": scale_colours(len(levels) - 1),
    }


def _packed(values: NDArray[np.float64]) -> str:
    """Base64 of little-endian float32, row by row."""
    return base64.b64encode(np.clip(values, -MOST, MOST).astype("<f4").tobytes()).decode("ascii")
