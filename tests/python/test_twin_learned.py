"""Panel of the dashboard, learned.json, a unit of one's own, a calibration, the next run: a user gets there what a twin has learned."""

import json
import math
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fivebar import scene as scenes_of
from fivebar.commands import main
from fivebar.own_unit import write_unit
from fivebar.twin import dashboard, figures, handover, scene
from fivebar.twin.follower import LEARNED
from fivebar.twin.messages import TRACKED
from fivebar.twin.soak import configured
from fivebar.twin.unit import Library, Unit
from fivebar.variables import of_unit
from twin_support import recorded

MASSES = tuple(f"link[{i}].mass" for i in (1, 2, 3, 4))


@pytest.fixture(scope="module")
def library(fmu: Path) -> Iterator[Library]:
    """The unit under test."""
    made = Library(fmu)
    yield made
    made.close()


def test_what_was_learned_makes_a_unit_a_calibration_and_the_next_run(tmp_path: Path, fmu: Path, library: Library) -> None:
    """Springs throw the machine about: two seconds tell its masses, which are 3 to 5 % off, to 0.5 %, and its payload, a fifth off, to 1 %."""
    config = configured(tmp_path / "first", fmu, library, "spring_payload", learn=True, exact=True)
    run, truth = recorded(config, library, 400), config.machine.hidden
    learned = figures.read(run.folder).learned
    assert learned is not None
    file = tmp_path / "learned.json"
    handover.write(file, config.path / scene.SOURCE, learned["values"])

    before, after = scenes_of.read("spring_payload", library.known), scenes_of.read(file, library.known)
    assert after.signals.keys() == before.signals.keys() and after.stop_time == before.stop_time
    for name in MASSES:
        off, learned_off = (abs(each[name] / truth[name] - 1) for each in (before, after))
        assert off > 0.025 and learned_off < 0.005, (name, off, learned_off)
        inertia = name.replace("mass", "inertia")
        # Inertia is learned along with its mass.
        assert after[inertia] / before[inertia] == pytest.approx(after[name] / before[name], rel=1e-12)
    assert abs(after["payload.mass"] / truth["payload.mass"] - 1) < 0.01
    # The scene has no friction, the machine has the unit's usual one.
    assert after["viscous.enabled"] is True and not before["viscous.enabled"]
    assert all(abs(after[f"viscous.b[{i}]"] / 1e-4 - 1) < 0.2 for i in range(1, 6))

    own = write_unit(tmp_path, after, plain=fmu).file
    assert own.name == "Learned.fmu" and of_unit(own)["link[1].mass"].start == learned["values"]["link[1].mass"]

    common = ["--fmu", str(fmu), "--scene", str(file), "--parameters", "payload.mass", "--seconds", "1", "--out", str(tmp_path / "calibrate")]
    assert main(["calibrate", str(run.folder), *common]) == 0
    found = json.loads((tmp_path / "calibrate" / "calibration.json").read_text())
    assert found["begins_from"] == f"scene {file}" and found["unknowns"]["payload.mass"]["scene"] == {"payload.mass": after["payload.mass"]}

    # Half a second of its own motion: the learned machine is fifty times nearer to the machine, and has to be ten times.
    tips = []
    unit = Unit(library)
    for values in (before.values | truth, before.values, after.values):
        unit.start(values)
        for k in range(1, 51):
            unit.step_to(0.01 * k)
        tips.append(tuple(unit.get(TRACKED).values()))
    unit.close()
    assert math.dist(tips[2], tips[0]) < 0.1 * math.dist(tips[1], tips[0]), tips


def test_a_variable_with_a_signal_keeps_it(tmp_path: Path, library: Library) -> None:
    """A payload that the scene changes with time is no start value, and a sentence does not come twice."""
    source, learned = scenes_of.found("pick_up"), tmp_path / "learned.json"
    signalled = json.loads(source.read_text())["signals"]
    assert "payload.mass" in signalled
    for given in (source, learned):
        handover.write(learned, given, {"payload.mass": 0.02, "link[1].mass": 0.018})
    content = json.loads(learned.read_text())
    assert content["link[1].mass"] == 0.018 and "payload.mass" not in content and content["signals"] == signalled
    assert content["description"].count(handover.TOLD) == 1
    scenes_of.read(learned, library.known)


def test_learning_is_off_unless_it_is_asked_for(tmp_path: Path, fmu: Path, library: Library, scenes: Path) -> None:
    """By the scene or by the switch; widths that the scene gives stay."""
    config = configured(tmp_path / "off", fmu, library, "pick_and_place")
    assert dashboard.about(config)["learned"] == []
    own = json.loads((scenes / "pick_and_place.json").read_text())
    (tmp_path / "own.json").write_text(json.dumps(own | {"estimator.learn.enabled": True, "estimator.learn.payload": 0.003}))
    shown = dashboard.about(configured(tmp_path / "scene", fmu, library, tmp_path / "own.json"))["learned"]
    assert {each["name"]: each["width"] for each in shown}["estimated.payload"] == 0.003 and not any("viscous" in each["name"] for each in shown)
    (tmp_path / "own.json").write_text(json.dumps(own | {"estimator.learn.viscous": 2e-5}))
    shown = dashboard.about(configured(tmp_path / "switch", fmu, library, tmp_path / "own.json", learn=True))["learned"]
    assert [each["name"] for each in shown] == [name for name in LEARNED if name != "estimated.friction"]
    for each in shown:
        assert each["unit"] in ("kg", "N.m.s/rad", "m", "rad") and each["label"] and each["width"] > 0 and each["sigma"] in library.variables
    last = next(each for each in shown if each["name"] == "estimated.viscous[5]")
    assert last["start"] == 0.0 and last["width"] == 2e-5


def test_the_page_counts_what_the_server_counts() -> None:
    """A page that counted other messages too would be sent more than it can draw."""
    script = (Path(dashboard.__file__).with_name("page") / "dashboard.js").read_text(encoding="utf-8")
    found = re.search(r"^const SKIPPED = (\[.*?\]);", script, re.MULTILINE)
    assert found and tuple(json.loads(found[1])) == dashboard.SKIPPED


def test_the_command_learns_and_hands_over(tmp_path: Path, fmu: Path) -> None:
    """Processes, broker and summary; a run that does not learn leaves no scene of an earlier one that did."""

    def text(*more: str) -> str:
        command = [sys.executable, "-m", "fivebar", "twin", "--seconds", "3", "--fmu", str(fmu), "--out", str(tmp_path), *more]
        run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
        assert run.returncode == 0, run.stdout + run.stderr
        return run.stdout

    assert f"in {tmp_path / 'learned.json'}" in text("--learn", "--exact")
    learned = json.loads((tmp_path / "summary.json").read_text())["learned"]
    content = json.loads((tmp_path / "learned.json").read_text())
    assert learned["values"].items() <= content.items() and content["payload.mass"] != 0.05
    assert abs(content["payload.mass"] / 0.06 - 1) < 0.05
    text()
    assert not (tmp_path / "learned.json").exists()
