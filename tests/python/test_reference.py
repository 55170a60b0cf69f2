"""The unit at its default settings against external reference values; references match their scenes.

tests/integration/accuracy.rs, dop853.rs and effects_reference.rs prove orders and errors of the methods.
"""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmpy.model_description import ModelDescription

from conftest import REPOSITORY
from fivebar import scene
from instance import Instance, Values

New = Callable[..., Instance]
REFERENCE = REPOSITORY / "tests" / "data" / "reference"
ELDER = ("fall-90-120", "torque")
"""References older than the scenes, with heads in prose."""

FALL_90_120: Values = {"init.theta[2]": 2.0943951023931953}


def reference(name: str) -> list[tuple[float, float, float]]:
    """(t, x, y) of the tip."""
    lines = [line for line in (REFERENCE / name).read_text().splitlines() if not line.startswith("#")]
    return [(float(row["t"]), float(row["Qx"]), float(row["Qy"])) for row in csv.DictReader(lines)]


def deviations(instance: Instance, points: list[tuple[float, float, float]]) -> list[float]:
    """Distance of the tip from the reference at every point, m."""
    found, now = [], 0.0
    for time, x, y in points:
        if time > now:
            instance.slave.doStep(now, time - now)
            now = time
        found.append(float(np.hypot(instance.get("tip.x") - x, instance.get("tip.y") - y)))
    return found


def test_default_settings(new: New) -> None:
    """Default settings: steps of 1 ms, divided if the local error requires it."""
    assert max(deviations(new().initialise(FALL_90_120), reference("fall-90-120.csv"))) < 1e-4


@pytest.mark.parametrize(
    "path", [p for p in sorted(REFERENCE.glob("*.csv")) if p.stem not in ELDER], ids=lambda path: path.stem
)
def test_references_are_those_of_the_scenes(path: Path, model: ModelDescription) -> None:
    """The values in a reference's head equal the scene's. A changed scene needs a new reference, unless only the solver's settings changed."""
    head = [line[2:].split(" = ") for line in path.read_text().splitlines() if line.startswith("# ") and " = " in line]
    content = json.loads((REPOSITORY / "scenes" / path.name).with_suffix(".json").read_text())
    moving = {"signals", *(v.name for v in model.modelVariables if not v.name.startswith("solver."))}
    assert {name: json.loads(value) for name, value in head} == {k: v for k, v in content.items() if k in moving}


@pytest.mark.parametrize(
    "name", ["paper_free_fall", "paper_torque", "paper_torque_gravity", "fall_90_120", "flat_table"]
)
def test_scenes_keep_their_energy(new: New, scenes: Path, name: str) -> None:
    """Every scene reaches its end with its own settings: values are finite, |energy.error| <= 1e-2 mgL, and constraints are satisfied."""
    instance = new()
    ready = scene.read(scenes / f"{name}.json")
    instance.initialise(ready.variants[0].values, stop_time=ready.stop_time)
    mgl = 0.017 * 9.81 * 0.21
    size = 0.01
    for i in range(round(ready.stop_time / size)):
        instance.slave.doStep(i * size, size)
        assert abs(instance.get("energy.error")) <= 1e-2 * mgl, f"at {(i + 1) * size} s"
        assert instance.get("solver.positionError") <= 1e-12
        assert instance.get("solver.velocityError") <= 1e-9
    assert np.isfinite(instance.tip()).all()
