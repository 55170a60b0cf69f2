"""Calibration by `fivebar calibrate` of a machine simulated in MuJoCo (machine.py), compared with the true values."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

import machine

SECONDS = 10.0
"""Length of the used part of the record, s, without pushes."""


def calibrate(folder: Path, fmu: Path, rows: np.ndarray, kinds: list[str], truth: machine.Truth) -> dict[str, object]:
    """Values, half-widths of their 95 % intervals and true values, by variable; residuals; a warning of the command, if any."""
    begin = _quiet(rows, kinds)
    command = [
        sys.executable,
        "-m",
        "fivebar",
        "calibrate",
        folder / "record.csv",
        "--scene",
        folder / "believed.json",
        "--commands",
        "hold",
    ]
    command += [
        "--from",
        f"{begin:g}",
        "--seconds",
        f"{SECONDS:g}",
        "--patience",
        "300",
        "--no-proposal",
        "--fmu",
        fmu,
        "--out",
        folder / "calibrate",
    ]
    done = subprocess.run([str(part) for part in command], check=False)
    if done.returncode not in (0, 1):
        return {"from, s": begin, "exit code": done.returncode}
    calibrated = json.loads((folder / "calibrate" / "calibration.json").read_text(encoding="utf-8"))
    true = true_values(truth)
    rows_of_table = {}
    for name, unknown in calibrated["unknowns"].items():
        for member in unknown["scene"] or {name: 0.0}:
            row = {"believed": unknown["scene"].get(member, 0.0), "true": true.get(member)}
            if unknown["identified"]:
                row |= {"found": unknown["value"][member], "bar": unknown["bar95"][member]}
                if row["true"] is not None:
                    row["inside"] = abs(row["found"] - row["true"]) <= row["bar"]
            rows_of_table[member] = row
    refusals = {name: calibrated[name] for name in ("refused", "warning") if calibrated[name]}
    return {"from, s": begin, **refusals, "residuals, rad": calibrated["residuals_rad"], "values": rows_of_table}


def _quiet(rows: np.ndarray, kinds: list[str]) -> float:
    """Start, s, of the part with the most motion and no push."""
    count = round(SECONDS / machine.SAMPLE)
    pushed, moving = np.hypot(rows[:, 7], rows[:, 8]) > 0, np.isin(kinds, ["pick", "sines"])
    starts = range(0, len(rows) - count, round(1 / machine.SAMPLE))
    best = max(starts, key=lambda i: float(moving[i : i + count].sum()) - 1e6 * float(pushed[i : i + count].any()))
    return best * machine.SAMPLE


def true_values(truth: machine.Truth) -> dict[str, float]:
    """True values, by the names of the unit's variables."""
    named = {f"link[{i}].length": float(value) for i, value in enumerate(truth.length, 1)}
    named |= {f"link[{i}].mass": float(value) for i, value in enumerate(truth.mass, 1)}
    named |= {f"viscous.b[{i}]": float(value) for i, value in enumerate(truth.viscous, 1)}
    named |= {f"friction.coulomb[{i}]": float(value) for i, value in zip((1, 5), truth.coulomb, strict=True)}
    named |= {f"encoder.offset[{i}]": float(value) for i, value in enumerate(truth.offset, 1)}
    return named | {"base.distance": truth.base, "gravity.direction": -np.pi / 2}


def show(found: dict[str, object]) -> str:
    """Estimated and true values as lines of a table."""
    if "values" not in found:
        return f"calibration from {found['from, s']:g} s on: exit code {found['exit code']}"
    lines = ["| variable | believed | true | found | 95 % bar | inside |", "| --- | ---: | ---: | ---: | ---: | --- |"]
    for name, row in found["values"].items():
        value = (
            f"{row['found']:.5g} | {row['bar']:.2g} | {'yes' if row.get('inside') else 'no'}"
            if "found" in row
            else "not identified | | "
        )
        true = "" if row["true"] is None else f"{row['true']:.5g}"
        lines.append(f"| `{name}` | {row['believed']:.5g} | {true} | {value} |")
    return "\n".join(
        [*lines, *(f"{name}: {found[name]}" for name in ("refused", "warning", "residuals, rad") if name in found)]
    )
