"""A unit packed for a scene, tests/data/own_machine.json: with nothing set it is the plain unit with the scene's values set."""

import json
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy.validation
import pytest
from fmpy import fmi2, simulate_fmu
from fmpy.model_description import ModelDescription

from conftest import REPOSITORY, Unit
from instance import Instance, Values

New = Callable[..., Instance]

NOT_VALUES = ("description", "experiment", "overlay", "signals")


@pytest.fixture(scope="module")
def scene() -> dict:
    """The file that the unit was packed from."""
    return json.loads((REPOSITORY / "tests" / "data" / "own_machine.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def values(scene: dict, model: ModelDescription) -> Values:
    """Values of the file as calls pass them; the signal has its value at 0 s."""
    items = {
        v.name: {i.name: int(i.value) for i in v.declaredType.items}
        for v in model.modelVariables
        if v.type == "Enumeration"
    }
    own = {name: items[name][x] if name in items else x for name, x in scene.items() if name not in NOT_VALUES}
    return own | {"tau[1]": scene["signals"]["tau[1]"]["linear"][0][1]}


def test_nothing_set_is_the_plain_unit_with_the_values_of_the_scene(new: New, new_own: New, values: Values) -> None:
    """Method, assembly and all other values are equal bit by bit."""
    plain, own = new().initialise(values), new_own().initialise()
    for step in range(200):
        assert own.bits() == plain.bits(), f"after {step} steps"
        for instance in (plain, own):
            instance.set({"tau[2]": 1e-4 * step})
            instance.slave.doStep(step * 0.002, 0.002)
    assert own.get("solver.steps") == 400 and own.get("energy.dissipated") > 0


def test_the_description_is_that_of_the_scene(own: Unit, model: ModelDescription, scene: dict, values: Values) -> None:
    mine = own.model
    assert mine.modelName == mine.coSimulation.modelIdentifier == own.fmu.stem == "OwnMachine"
    assert mine.guid != model.guid
    assert mine.description.startswith(scene["description"]) and mine.description.endswith(
        "the master must change them: tau[1]."
    )
    experiment = mine.defaultExperiment
    assert [float(x) for x in (experiment.startTime, experiment.stopTime, experiment.stepSize)] == [0, 1.5, 0.002]
    for here, plain in zip(mine.modelVariables, model.modelVariables, strict=True):
        assert (here.name, here.valueReference, here.causality) == (plain.name, plain.valueReference, plain.causality)
        expected = values.get(here.name)
        if expected is None:
            assert here.start == plain.start, here.name
        else:
            assert {"true": True, "false": False}.get(here.start, here.start) == expected or float(
                here.start
            ) == expected, here.name


def test_fmpy_finds_no_problem(own: Unit) -> None:
    assert fmpy.validation.validate_fmu(str(own.fmu)) == []


@pytest.mark.full
def test_fmutool_finds_no_problem(own: Unit) -> None:
    command = [str(Path(sys.executable).parent / "fmutool"), "-input", str(own.fmu), "-check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_page_inside_says_what_is_different(own: Unit, values: Values) -> None:
    with zipfile.ZipFile(own.fmu) as archive:
        page = archive.read("documentation/index.html").decode()
    section = page[page.index("<h2>OwnMachine</h2>") : page.index("<figure>")]
    rows = re.findall(r"<tr><td><code>(.*?)</code></td><td>(.*?)</td>", section)
    assert [name for name, _ in rows] == list(values)
    assert ("solver.method", "dop853") in rows and ("base.distance", "0.1") in rows and ("tau[1]", "0.01") in rows
    assert "&amp; crossed legs" in section and "1.5 s, in steps of 0.002 s" in section


def test_the_default_experiment_runs(own: Unit) -> None:
    """With nothing set, the start posture is the scene's, and the energies balance."""
    result = simulate_fmu(str(own.fmu), output=["theta[1]", "tip.y", "energy.error", "mode.assembly"])
    assert result["time"][-1] == pytest.approx(1.5) and result["theta[1]"][0] == 1.0 and result["mode.assembly"][0] == 2
    assert abs(result["tip.y"][-1] - result["tip.y"][0]) > 0.1
    assert max(abs(result["energy.error"])) < 1e-8


def test_all_else_can_still_be_set(new_own: New) -> None:
    instance = new_own().initialise({"solver.method": 1, "payload.enabled": False})
    instance.steps(3, 1e-3)
    assert instance.get("solver.method") == 1 and instance.get("solver.substeps") >= 3


def test_reset_brings_its_own_starts_back(new_own: New) -> None:
    instance = new_own()
    instance.initialise({"init.theta[1]": 1.2, "solver.method": 1})
    instance.steps(5, 0.002)
    instance.slave.reset()
    assert instance.initialise().bits() == new_own().initialise().bits()


def test_a_stored_state_continues_only_in_its_own_unit(new: New, new_own: New) -> None:
    """A stored state continues in the instance, in another one, and from bytes; the plain unit refuses the bytes, by the GUID, and the state."""
    first, second, plain = new_own().initialise(), new_own().initialise(), new().initialise()
    first.steps(50, 0.002)
    state = first.slave.getFMUState()
    stored = bytes(first.slave.serializeFMUState(state))
    first.steps(100, 0.002, begin=0.1)
    end = first.bits()
    first.slave.setFMUState(state)
    first.steps(100, 0.002, begin=0.1)
    assert first.bits() == end
    first.slave.freeFMUState(state)
    brought = second.slave.deserializeFMUState(stored)
    second.slave.setFMUState(brought)
    second.steps(100, 0.002, begin=0.1)
    assert second.bits() == end
    second.slave.freeFMUState(brought)
    before = plain.bits()
    status, text = plain.refusal(plain.slave.deserializeFMUState, stored)
    assert status == fmi2.fmi2Error and "GUID" in text and plain.bits() == before
    status, text = first.refusal(
        first.slave.deserializeFMUState, bytes(plain.slave.serializeFMUState(plain.slave.getFMUState()))
    )
    assert status == fmi2.fmi2Error and "another unit or version" in text


def test_two_units_side_by_side_have_no_influence(new: New, new_own: New) -> None:
    alone, beside, plain = new_own().initialise(), new_own().initialise(), new().initialise()
    alone.steps(100, 0.002)
    for step in range(100):
        plain.slave.doStep(step * 0.002, 0.002)
        beside.slave.doStep(step * 0.002, 0.002)
    assert beside.bits() == alone.bits() != plain.bits()


def test_a_start_that_is_refused_leaves_nothing(fmu: Path, tmp_path: Path) -> None:
    """The packer writes no file and prints one sentence, the unit's."""
    file = tmp_path / "too_far.json"
    file.write_text(json.dumps({"description": "Motors too far apart", "base.distance": 5.0}), encoding="utf-8")
    command = ["cargo", "xtask", "package", "--scene", str(file)]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert done.returncode != 0 and "the start is refused: fmi2ExitInitializationMode: " in done.stderr
    assert not [*fmu.parent.glob("*TooFar*")]
