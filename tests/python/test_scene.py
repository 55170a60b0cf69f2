"""Scenes: how files are read, and how a run applies signals."""

import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.model_description import ModelDescription

import fivebar
from fivebar import scene, shipped
from fivebar.drive import Run, drive
from fivebar.errors import FiveBarError, MachineWarning
from fivebar.library import shared
from fivebar.variables import Variables
from made_scene import METHODS, made_scene, write


def test_every_shipped_scene_is_read(scenes: Path, model: ModelDescription) -> None:
    """The numbers of methods in the tests equal the FMU's."""
    names = {path.stem for path in scenes.glob("*.json")}
    assert names == set(fivebar.scenes()) >= {"paper_free_fall", "haptic"}
    for name in names:
        ready = scene.read(name)
        assert ready.name == name and ready.description == fivebar.scenes()[name] and ready.variants[0].label == "i3alp"
        points = scene.communication_points(ready.stop_time, ready.step_size)
        assert all(len(values) == len(points) for values in ready.signals.values())
    assert Variables(model)["solver.method"].items == METHODS


def test_a_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    fine = scene.Variant(
        "fine", {"tau[1]": 1.0, "gravity.enabled": False, "solver.method": METHODS["rk4"], "solver.stepSize": 1e-5}
    )
    made = made_scene({"tau[1]": 1.0, "gravity.enabled": False}, 0.1, 0.05, fine)
    made = replace(made, signals={"tip.fx": np.array([0.0, 0.1, 0.25])})
    ready = scene.read(write(tmp_path / "trial.json", made))
    assert ready.signals["tip.fx"].tolist() == [0.0, 0.1, 0.25]
    assert replace(ready, signals={}) == replace(made, signals={})


def test_other_start_values_go_to_all_runs_but_where_they_have_their_own() -> None:
    fine = scene.Variant("fine", {"tau[1]": 1.0, "gravity.g": 3.0, "solver.method": METHODS["rk4"]})
    made = made_scene({"tau[1]": 1.0, "gravity.g": 9.0}, 0.1, 0.05, fine)
    changed = made.replace({"gravity.g": 5.0, "tau[2]": 1, "solver.method": "automatic"})
    own, overlay = changed.variants
    assert (own.label, own.values) == (
        "automatic",
        {"tau[1]": 1.0, "tau[2]": 1.0, "gravity.g": 5.0, "solver.method": METHODS["automatic"]},
    )
    assert overlay.values == {"tau[1]": 1.0, "tau[2]": 1.0, "gravity.g": 3.0, "solver.method": METHODS["rk4"]}
    with pytest.raises(FiveBarError, match="'tip.fx' has a signal and a value"):
        replace(made, signals={"tip.fx": np.zeros(3)}).replace({"tip.fx": 1.0})


@pytest.mark.parametrize(
    ("step", "stop", "expected"),
    [
        (0.01, 9.0, (0.01, 0.05, [0, 1, 2, 3, 4, 5])),
        (0.001, 9.0, (0.01, 0.05, [0, 1, 2, 3, 4, 5])),
        (0.02, 9.0, (0.02, 0.05, [0, 2, 4, 5])),
        (0.015, 0.04, (0.02, 0.04, [0, 2, 4])),
        (9.0, 0.03, (9.0, 0.03, [0, 5])),
    ],
)
def test_coarser(step: float, stop: float, expected: tuple[float, float, list[int]]) -> None:
    """The step is a multiple of the scene's step; at the end a signal has its last value."""
    fine = replace(made_scene({}, 0.05, 0.01), signals={"tau[1]": np.arange(6.0)})
    coarse = fine.coarser(step, stop)
    assert (coarse.step_size, coarse.stop_time, coarse.signals["tau[1]"].tolist()) == expected


def run(ready: scene.Scene, fmu: Path) -> Run:
    """A run of a scene."""
    return drive(shared(fmu), ready, ready.variants[0])


def test_a_signal_is_held_from_each_communication_point(fmu: Path) -> None:
    """A ramp sampled at 0, 10, 20, ... ms is a flight of stairs that begins at 0."""
    ramp = np.linspace(0, 1e-3, 11)
    rest = made_scene({"gravity.enabled": False, "solver.stepSize": 1e-3}, 0.1, 0.01)
    signalled = run(replace(rest, signals={"tau[1]": ramp}), fmu)
    assert signalled["tau[1]"].tolist() == ramp.tolist()
    # The first step uses the value at 0, which is 0: the machine stays at rest, up to round-off.
    assert abs(signalled["omega[1]"][1]) < 1e-15 and 1e-4 < signalled["omega[1]"][2]
    # Input work is constant torque times rotation, step by step; the integrator's error is 1e-6 of it.
    work = np.sum(signalled["tau[1]"][:-1] * np.diff(signalled["theta[1]"]))
    assert signalled["energy.input"][-1] == pytest.approx(work, rel=1e-6)


def test_the_start_has_the_signals_first_values(fmu: Path) -> None:
    push = replace(made_scene({"gravity.enabled": False}, 0.01), signals={"tau[1]": np.linspace(0.1, 0.2, 11)})
    held = run(made_scene({"gravity.enabled": False, "tau[1]": 0.1}, 0.01), fmu)
    assert run(push, fmu)["alpha[1]"][0] == held["alpha[1]"][0] != 0.0


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"link[1].length": 0.09}, "link[1].com is 0.105 m, beyond the joints of a link of 0.09 m"),
        ({"link[3].com": -0.01}, "link[3].com is -0.01 m, beyond the joints of a link of 0.21 m"),
        (
            {"link[2].length": 0.12},
            "link[2].inertia is 6.23e-05 kg.m2 about the centre of mass, more than the 2.68e-05 kg.m2",
        ),
        (
            {"link[4].inertia": 2.5e-4},
            "link[4].inertia is 0.00025 kg.m2 about the centre of mass, more than the 0.000187 kg.m2",
        ),
        (
            {"init.theta[1]": 126.0, "init.theta[2]": 90.0},
            "init.theta[1] is 126 rad, which is 20 turns: is it in degrees?",
        ),
        ({"base.distance": 120.0}, "base.distance is 120 m: is it in millimetres?"),
    ],
)
def test_an_impossible_machine_is_named(values: dict[str, float], sentence: str) -> None:
    """A counterweight could explain a mass beyond the joints, and a large angle may be meant, so these are warnings."""
    with pytest.warns(MachineWarning) as caught:
        read = scene.parse("own", json.dumps({"description": "Own."} | values))
    [warning] = caught
    assert str(warning.message).startswith(f"own: {sentence}") and read.values == values


@pytest.mark.parametrize(
    "given",
    [
        {"init.theta": (1.5, 2.0)},
        {"init.theta": np.array([1.5, 2.0])},
        {"init.theta[1]": np.array(1.5), "init.theta[2]": np.float32(2.0)},
    ],
    ids=["tuple", "array", "numbers"],
)
def test_arrays_are_start_values_by_their_name(given: dict[str, Any]) -> None:
    made = scene.read("swing").replace(stop_time=np.array(0.01))
    for each in (
        made.replace(**given),
        scene.read(given),
        scene.read({"overlay": [{"label": "other", **given}]}).variants[1],
        fivebar.run(made, **given).scene,
        fivebar.run_many(made, [given], processes=1, progress=False)[0].scene,
    ):
        assert (each.values["init.theta[1]"], each.values["init.theta[2]"]) == (1.5, 2.0)
    assert made.replace(**given)["init.theta"].tolist() == [1.5, 2.0]
    with pytest.raises(
        FiveBarError, match=r"'init.theta' has 2 elements, init.theta\[1\] to init.theta\[2\], but is given 3"
    ):
        made.replace(**{"init.theta": (1, 2, 3)})


def test_an_enumeration_is_the_name_of_its_item() -> None:
    made = scene.read({"friction.law": "stick"})
    assert (made["friction.law"], made["contact.law"], made["gravity.enabled"]) == ("stick", "smooth", True)


def test_scenes_are_read_as_they_were_written(tmp_path: Path) -> None:
    """Shipped scenes with knots, overlays and the tip's coordinates, and inputs given in Python; offsets, name and description."""
    pushed = scene.read("swing").replace(
        stop_time=0.1, inputs={"tau": np.random.default_rng(1).normal(size=(101, 2)), "payload.mass": 0.02}
    )
    pushed = replace(pushed, offsets={"encoder.offset[1]": 0.01}).replace(
        name="mine", description="My machine.", method="i3alp"
    )
    for made in (*map(scene.read, shipped.scene_files()), pushed, pushed.replace(step_size=5e-4)):
        again = scene.read(made.write(tmp_path / f"{made.name}.json"))
        assert again.resolved() == made.resolved() and again.offsets == made.offsets
        assert again.with_method().variants == made.with_method().variants
        assert again.knots.keys() >= made.knots.keys() and again.tip == made.tip
    assert (again.name, again.description) == ("mine", "My machine.")


LINE = {f"tip.{axis}": {"linear": [[0.0, at], [0.1, at + 0.02]]} for axis, at in (("x", 0.2), ("y", 0.25))}


def test_a_file_has_the_references_that_replaced_the_tips_signals(tmp_path: Path) -> None:
    moved = scene.read({"servo.enabled": True, "experiment": {"stopTime": 0.1, "stepSize": 0.001}, "signals": LINE})
    given = moved.replace(inputs={"servo.theta": (1.0, 2.0)})
    again = scene.read(given.write(tmp_path / "scene.json"))
    assert again.signals["servo.theta[1]"].tolist() == [1.0] * 101 and again.resolved() == {
        **given.resolved(),
        "description": again.description,
    }
    assert given.signals["servo.omega[1]"].tolist() == moved.signals["servo.omega[1]"].tolist()
    assert given.replace({"link[1].mass": 0.02}).signals["servo.theta[2]"].tolist() == [2.0] * 101


@pytest.mark.parametrize("values", [{"init.theta[1]": 2.2}, {"init.assembly": "minus"}, {"init.assembly": "plus"}])
@pytest.mark.parametrize("signals", [{}, LINE], ids=["start", "signals"])
def test_a_file_has_initial_angles_or_the_tips_place(
    values: dict[str, Any], signals: dict[str, Any], tmp_path: Path
) -> None:
    given = {
        "experiment": {"stopTime": 0.1, "stepSize": 0.001},
        "tip.x": 0.2,
        "tip.y": 0.25,
        "mode.working": ["minus", "plus"],
        "overlay": [{"label": "longer", "link[1].length": 0.22}],
    } | ({"signals": signals} if signals else {})
    changed = scene.read(given).replace(values)
    assert scene.read(changed.write(tmp_path / "scene.json")).resolved() == changed.resolved()


def test_what_a_file_cannot_have_is_refused(tmp_path: Path) -> None:
    swing, file = scene.read("swing"), tmp_path / "scene.json"
    for made in (
        swing.replace({"servo.limit": (0.5, np.inf), "servo.enabled": True}),
        replace(swing, variants=[*swing.variants, scene.Variant("strong", {"servo.limit[2]": np.inf})]),
    ):
        with pytest.raises(
            FiveBarError, match=r"'servo\.limit\[2\]' is inf, but a scene's file has finite numbers only$"
        ):
            made.write(file)
    up = scene.read({"tip.x": 0.2, "signals": {"tip.y": LINE["tip.y"]}}).replace({"init.theta[1]": 2.2})
    with pytest.raises(
        FiveBarError, match=r"^'init\.theta\[1\]' is given, but 'tip\.x' at the start is the tip's reference"
    ):
        up.write(file)
    assert not file.exists()


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda made: made.write("mine.txt"), "'file' must end in .json, not \"mine.txt\""),
        (lambda made: made.replace(name="a/b"), "'name' must be a name of a file without its folder, not \"a/b\""),
        (lambda made: made.replace(description=3), "'description' must be a text, not 3"),
    ],
)
def test_names_of_scenes_are_checked(call: Callable[[scene.Scene], object], sentence: str) -> None:
    with pytest.raises(FiveBarError) as refused:
        call(scene.read("swing"))
    assert str(refused.value) == sentence


HEAVY_END = {"link[1].com": 5.0}


@pytest.mark.parametrize(
    "start",
    [
        lambda: fivebar.run("fall_90_120", stop_time=0.01, **HEAVY_END),
        lambda: fivebar.run_many("swing", [HEAVY_END], stop_time=0.01, processes=1, progress=False),
        lambda: scene.read("swing").replace(HEAVY_END).replace(stop_time=0.01).with_method(),
        lambda: fivebar.Unit(**HEAVY_END),
        lambda: fivebar.Unit("swing", **HEAVY_END),
        lambda: fivebar.run(HEAVY_END, stop_time=0.01, **{"link[2].mass": 0.02}),
    ],
    ids=["run", "run_many", "replace", "unit", "unit of a scene", "dict"],
)
def test_start_values_in_keywords_are_checked_once(start: Callable[[], object]) -> None:
    """The warning is at the caller's line."""
    with pytest.warns(MachineWarning, match=r"link\[1\].com is 5 m, beyond the joints") as caught:
        start()
    [warning] = caught
    assert warning.filename == __file__


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"rotor.inertia[1]": 1e-3, "rotor.inertia[2]": 1e-3}, "rotor.inertia[1] is 0.001, but no active effect reads it: rotor.enabled is false"),
        ({"friction.law": "stick"}, "friction.law is stick, but no active effect reads it: friction.enabled is false"),
    ],
)  # fmt: skip
def test_parameters_of_an_effect_that_is_off_are_named(values: dict[str, Any], sentence: str) -> None:
    fall = scene.read({"gravity.enabled": True})
    for start, name in ((lambda: fall.replace(values), "scene"), (lambda: fivebar.Unit(**values), "unit")):
        with pytest.warns(MachineWarning) as caught:
            start()
        [warning] = caught
        assert str(warning.message) == f"{name}: {sentence}"


def test_parameters_that_a_run_reads_or_a_file_has_are_silent() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = scene.read({"rotor.inertia[1]": 1e-3, "overlay": [{"label": "payload", "payload.enabled": True}]})
        made = made.replace({"payload.mass": 0.2, "rotor.inertia[1]": 1e-3, "servo.kp[1]": made["servo.kp[1]"]})
        made.replace({"spring.k[1]": 1, "spring.enabled": True})
        off = {"viscous.b[1]": 1e-3, "viscous.enabled": False}
        made.replace(off)
        fivebar.Unit(**off)
        fivebar.Unit("swing", **off)


def test_a_unit_of_a_scene_warns_once() -> None:
    with pytest.warns(MachineWarning) as caught:
        unit = fivebar.Unit("swing", **{"viscous.b": [1e-3] * 5})
    [warning] = caught
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        unit.reset()
        unit.reset(**{"viscous.b[1]": 2e-3})
    assert str(warning.message).startswith("swing: viscous.b[1] is 0.001, but no active effect reads it")
    with pytest.raises(FiveBarError, match=r"'link\[1\].mass' must be a number in kg"):
        unit.reset(**{"link[1].mass": -1})


def test_rods_and_masses_at_both_ends_are_possible() -> None:
    """The bound is half of the mass in each joint."""
    rod = {"link[1].length": 0.3, "link[1].com": 0.15, "link[1].mass": 0.02, "link[1].inertia": 0.02 * 0.15 * 0.15}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.parse("own", json.dumps({"description": "Own."} | rod))
        for name in shipped.scene_files():
            scene.read(name)
