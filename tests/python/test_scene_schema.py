"""The schema of scenes is valid, accepts all shipped scenes, and refuses every key with a wrong value that the reader refuses."""

import json
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from conftest import REPOSITORY
from fivebar import scene, scene_schema
from fivebar.commands import main
from fivebar.errors import FiveBarError
from fivebar.variables import of_unit


@pytest.fixture(scope="module")
def validator(fmu: Path) -> Draft202012Validator:
    made = scene_schema.schema(of_unit(fmu))
    Draft202012Validator.check_schema(made)
    return Draft202012Validator(made)


def test_the_command_prints_the_schema(validator: Draft202012Validator, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes", "--schema"]) == 0
    assert json.loads(capsys.readouterr().out) == validator.schema


def test_scenes_of_the_repository_fit(validator: Draft202012Validator, scenes: Path) -> None:
    """Also scenes in the documentation, and the key `$schema` for editors."""
    files = [*scenes.glob("*.json"), REPOSITORY / "tests" / "data" / "own_machine.json"]
    given = [json.loads(file.read_text(encoding="utf-8")) for file in files]
    for page in ("docs/my-machine.md", "docs/scenes.md", "docs/kinematics.md"):
        blocks = (REPOSITORY / page).read_text(encoding="utf-8").split("```json\n")[1:]
        given += [json.loads(block.split("```")[0]) for block in blocks]
    assert len(given) > 24
    for content in given:
        own = content | {"$schema": "./fivebar.schema.json"}
        assert list(validator.iter_errors(own)) == []
        assert scene.read(own).values == scene.read(content).values


def test_names_have_units_bounds_and_items(validator: Draft202012Validator) -> None:
    properties = validator.schema["properties"]
    assert properties["servo.limit[1]"] == {
        "type": "number", "description": "Largest torque of the left servo (N.m)", "minimum": 1e-9, "default": 1.0,
    }  # fmt: skip
    assert properties["init.assembly"]["enum"] == ["plus", "minus"] and properties["init.assembly"]["default"] == "plus"
    assert properties["gravity.enabled"]["type"] == "boolean"
    assert set(of_unit().start) <= set(properties)
    moved = properties["signals"]["properties"]
    assert moved["servo.omega[1]"]["properties"]["rateOf"]["enum"][:2] == ["servo.theta[1]", "servo.theta[2]"]
    assert "payload.mass" not in moved["servo.omega[1]"]["properties"]["rateOf"]["enum"]
    assert list(moved["payload.mass"]["properties"]) == ["steps"]


RAMP = {"linear": [[0, 0], [1, 1]]}


@pytest.mark.parametrize(
    "wrong",
    [
        {"tau[3]": 1}, {"tip.vx": 1}, {"tau[1]": "1"}, {"tau[1]": True}, {"gravity.enabled": 1}, {"solver.method": "euler"},
        {"solver.method": 1}, {"solver.maxIterations": 1.5}, {"servo.limit[1]": 0}, {"link[1].mass": -1}, {"description": " "}, {"description": "a\nb"},
        {"$schema": 1}, {"experiment": {"stop": 1}}, {"experiment": {"stopTime": 0}}, {"overlay": [{}]}, {"overlay": {"label": "a"}},
        {"overlay": [{"label": "a", "tau[3]": 1}]}, {"encoder.offset[1]": 4}, {"mode.working": ["plus"]}, {"mode.assembly": "up"},
        {"tip.x": "0"}, {"signals": {"tau[3]": RAMP}}, {"signals": {"payload.mass": RAMP}}, {"signals": {"link[1].mass": {"steps": [[0, 0], [1, 1]]}}},
        {"signals": {"tau[1]": {}}}, {"signals": {"tau[1]": RAMP | {"steps": [[0, 0], [1, 1]]}}}, {"signals": {"tau[1]": {"linear": [[0, 0]]}}},
        {"signals": {"tau[1]": {"linear": [[0, 0], [1]]}}}, {"signals": {"tau[1]": {"rateOf": "servo.theta[1]"}}},
        {"signals": {"servo.theta[1]": RAMP, "servo.omega[1]": {"rateOf": "tau[1]"}}}, {"signals": []},
        {"signals": {"gravity.direction": {"steps": [[0, 0], [1, 1]]}, "servo.omega[1]": {"rateOf": "gravity.direction"}}},
    ],
    ids=json.dumps,
)  # fmt: skip
def test_wrong_scenes_do_not_fit(validator: Draft202012Validator, wrong: dict[str, Any]) -> None:
    """Wrong names, types and bounds; the reader refuses the same scenes."""
    content = {"description": "trial"} | wrong
    assert not validator.is_valid(content)
    with pytest.raises(FiveBarError):
        scene.read(content)


def test_a_description_is_needed(validator: Draft202012Validator) -> None:
    assert validator.is_valid({"description": "trial"}) and not validator.is_valid({})
