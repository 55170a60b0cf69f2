"""Scenes: what is read, and the sentence for what is not."""

import json
import re
from pathlib import Path

import pytest
from fmpy.model_description import ModelDescription

import scene


def write(folder: Path, content: object) -> Path:
    """A scene file with `content`, a text or something for JSON."""
    path = folder / "trial.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def test_shipped_scenes(scenes: Path, model: ModelDescription) -> None:
    names = {path.stem for path in scenes.glob("*.json")}
    paper = {"paper_free_fall", "paper_torque", "paper_torque_gravity"}
    assert names >= paper | {"fall_90_120", "flat_table", "singular_crossing", "haptic", "pick_and_place", "end_stops", "run_down"}
    for name in names:
        ready = scene.read(scenes / f"{name}.json", model)
        assert ready.description and ready.stop_time > 0 and ready.step_size > 0


def test_shipped_scenes_say_only_what_differs(scenes: Path, model: ModelDescription) -> None:
    starts = {v.name: v.start for v in model.modelVariables}
    for path in scenes.glob("*.json"):
        for name, value in scene.read(path, model).variants[0].values.items():
            plain = {"true": 1, "false": 0}.get(starts[name], starts[name])
            assert float(plain) != float(value), f"{path.name} repeats the default of {name}"


def test_docs_list_every_scene_with_its_effects(scenes: Path, model: ModelDescription) -> None:
    """docs/effects.md, and the scene that it shows can be read."""
    text = (scenes.parent / "docs" / "effects.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| \[`(\w+)`\]\([^)]*\) \| [^|]* \| ([^|]*) \|", text, re.MULTILINE))
    switches = {v.name.removesuffix(".enabled"): v.start == "true" for v in model.modelVariables if v.name.endswith(".enabled")}
    for path in scenes.glob("*.json"):
        values = scene.read(path, model).variants[0].values
        active = [name for name, start in switches.items() if values.get(f"{name}.enabled", start)]
        assert rows.pop(path.stem) == (", ".join(active) or "none"), path.stem
    assert rows == {}


def test_the_scene_in_the_docs_is_one(scenes: Path, model: ModelDescription, tmp_path: Path) -> None:
    text = (scenes.parent / "docs" / "effects.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```json\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    assert set(scene.read(write(tmp_path, block), model).signals) == {"servo.theta[1]", "servo.omega[1]"}


def test_values_and_overlays(tmp_path: Path, model: ModelDescription) -> None:
    path = write(
        tmp_path,
        {
            "description": "trial",
            "experiment": {"stopTime": 2},
            "tau[1]": 1,
            "gravity.enabled": False,
            "solver.maxIterations": 20,
            "overlay": [{"label": "fine", "solver.method": "rk4", "tau[1]": 0.5}],
        },
    )
    ready = scene.read(path, model)
    assert (ready.name, ready.stop_time, ready.step_size) == ("trial", 2.0, 0.001)
    own, overlay = ready.variants
    assert own == scene.Variant("i3alp", {"tau[1]": 1.0, "gravity.enabled": False, "solver.maxIterations": 20})
    assert overlay.label == "fine"
    assert overlay.values == own.values | {"tau[1]": 0.5, "solver.method": 3}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"gravity.enable": False}, ("gravity.enable", "did you mean", "gravity.enabled")),
        ({"descripton": "x"}, ("descripton", "description")),
        ({"zzz": 1}, ("zzz", "known")),
        ({"tip.x": 0.1}, ("tip.x", "cannot be set")),
        ({"solver.method": "euler"}, ("solver.method", "i3alp", "rk4", "euler")),
        ({"solver.method": 3}, ("solver.method", "i3alp")),
        ({"tau[1]": "much"}, ("tau[1]", "N.m", "much")),
        ({"tau[1]": True}, ("tau[1]", "true")),
        ({"gravity.enabled": 1}, ("gravity.enabled", "true or false")),
        ({"solver.maxIterations": 1.5}, ("solver.maxIterations", "whole")),
        ('{"tau[1]": NaN}', ("tau[1]", "NaN")),
        ('{"tau[1]": 1, "tau[1]": 2}', ("tau[1]", "twice")),
        ('{"tau[1]": }', ("trial.json", "JSON", "line 1")),
        ("[]", ("trial.json", "object")),
        ({"experiment": {"stoptime": 1}}, ("stoptime", "stopTime")),
        ({"experiment": {"stopTime": -1}}, ("experiment.stopTime", "-1")),
        ({"experiment": {"stepSize": "1 ms"}}, ("experiment.stepSize", "1 ms")),
        ({"experiment": 5}, ("experiment",)),
        ({"overlay": {}}, ("overlay", "list")),
        ({"overlay": [{"tau[1]": 1}]}, ("overlay 1", "label")),
        ({"overlay": [{"label": "a", "tau[3]": 1}]}, ("overlay 1", "tau[3]", "tau[1]")),
        ({"overlay": [{"label": "a"}, {"label": "a"}]}, ("'a'", "labels")),
        ({"description": 5}, ("description",)),
    ],
)
def test_refused(tmp_path: Path, model: ModelDescription, content: object, words: tuple[str, ...]) -> None:
    with pytest.raises(scene.SceneError) as refusal:
        scene.read(write(tmp_path, content), model)
    for word in words:
        assert word in str(refusal.value)


def test_a_missing_scene_lists_its_neighbours(scenes: Path, model: ModelDescription) -> None:
    with pytest.raises(scene.SceneError, match=r"paper_fall.*fall_90_120.*paper_torque"):
        scene.read(scenes / "paper_fall.json", model)
