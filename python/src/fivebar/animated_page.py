"""One self-contained page that animates a scene: the template `animation.html`, filled with the data of the runs."""

import base64
import html
import json
from pathlib import Path

import numpy as np

from fivebar.borders import REACH, outline
from fivebar.colours import STYLE_SHEET
from fivebar.drawing import plane
from fivebar.drive import Run
from fivebar.kinematics import GEOMETRY, Machine
from fivebar.scene import Scene
from fivebar.singularities import Event, count
from fivebar.summary import energy_note, energy_scale, sampling

TEMPLATE = Path(__file__).with_name("animation.html")
ANGLES = ("theta[1]", "passive.theta[1]", "passive.theta[2]", "theta[2]")
ENERGIES = ("energy.kinetic", "energy.potential", "energy.input", "energy.dissipated", "energy.error")

SHORT_RUN = 3000
"""Runs with at most this many samples are shown sample by sample."""

FRAME = 0.01
"""Longest time between two samples of a longer run, s."""

TURN = 0.05
"""Largest turn of a link between two samples of a longer run, rad: the page interpolates the angles between samples."""

MOST_SAMPLES = 40_000
"""Largest number of samples of all runs of a page; beyond it `TURN` is relaxed. This keeps the page below 3 MB."""


def write(path: Path, scene: Scene, runs: list[Run], events: list[Event]) -> None:
    """Writes the page."""
    data = {
        "name": scene.name,
        "description": scene.description,
        "runs": [_pack(run, events if i == 0 else [], MOST_SAMPLES // len(runs)) for i, run in enumerate(runs)],
        "sampling": f"Singularities: {count(events)}; {sampling(runs[0])}.",
        "events": [{"t": e.time, "kind": e.kind, "text": str(e)} for e in events],
    }
    # "</" would end the script element with the data.
    packed = json.dumps(data, ensure_ascii=False).replace("</", "<\\/")
    page = TEMPLATE.read_text(encoding="utf-8")
    page = (
        page.replace("{{title}}", html.escape(scene.name))
        .replace("{{colours}}", STYLE_SHEET.read_text(encoding="utf-8"))
        .replace("{{reach}}", REACH.read_text(encoding="utf-8"))
        .replace("{{data}}", packed)
    )
    path.write_text(page, encoding="utf-8")


def _pack(run: Run, events: list[Event], most: int) -> dict[str, object]:
    """Data of a run: geometry and barriers as numbers; time, angles and energies as base64 of little-endian float32, column by column."""
    kept = samples_to_keep(run, events, most)
    columns = [run["time"], *(run[name] for name in ANGLES + ENERGIES)]
    table = np.array([column[kept] for column in columns], dtype="<f4")
    return {
        "label": run.label,
        "failure": run.failure,
        "base": run.parameters["base.distance"],
        "lengths": [run.parameters[f"link[{i}].length"] for i in (1, 2, 3, 4)],
        "outline": outline(Machine.from_values({name: run.parameters[name] for name in GEOMETRY})),
        "plane": _plane(run),
        "stops": _stops(run),
        "energyScale": energy_scale(run),
        "energyNote": energy_note(run),
        "samples": len(kept),
        "columns": base64.b64encode(table.tobytes()).decode("ascii"),
    }


def _plane(run: Run) -> dict[str, object] | None:
    """The plane that the tip may touch, if there is one."""
    if not run.parameters["contact.enabled"]:
        return None
    normal, offset = plane(run)
    return {"normal": normal.tolist(), "offset": offset}


def _stops(run: Run) -> list[list[float]] | None:
    """Lower and upper angle, rad, of the left and right end stops, if there are any."""
    if not run.parameters["stop.enabled"]:
        return None
    return [[run.parameters[f"stop.{limit}[{i}]"] for limit in ("lower", "upper")] for i in (1, 2)]


def samples_to_keep(run: Run, events: list[Event], most: int) -> np.ndarray:
    """Indices of the samples to show: at regular times, more often while a link turns fast, and around events."""
    count = len(run.time)
    if count <= SHORT_RUN:
        return np.arange(count)
    fastest = np.max([np.abs(np.diff(run[name], prepend=run[name][0])) for name in ANGLES], axis=0)
    turned = np.cumsum(fastest)
    around = {0, count - 1}
    for event in events:
        i = int(np.searchsorted(run.time, event.time))
        around.update(j for j in (i - 1, i) if 0 <= j < count)
    turn = TURN
    while True:
        # Keep a sample if it enters the next cell of the time grid or of the grid of the angle turned so far.
        cells = np.floor(run.time / FRAME + 1e-9), np.floor(turned / turn)
        regular = np.flatnonzero(np.any([np.diff(c, prepend=-1) > 0 for c in cells], axis=0))
        kept = np.array(sorted(around.union(regular.tolist())))
        if len(kept) <= most or turn > 1:
            return kept
        turn *= 2
