"""`fivebar calibrate`: unknowns of made records are found within their error bars; unknowns that cannot be found are named."""

import json
import math
import os
import pickle
import re
import shlex
import shutil
import subprocess
import sys
import warnings
from dataclasses import FrozenInstanceError, replace
from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas
import pytest

import fivebar
from fivebar import scene as scenes_of
from fivebar.commands import main
from fivebar.errors import MachineWarning
from fivebar.library import Library
from fivebar.scene_file import OFFSETS
from fivebar.twin import record, recording, setup
from fivebar.twin import scene as twin_scene
from fivebar.twin.calibrate import (
    assumptions,
    calibration,
    data,
    fit,
    identify,
    motion,
    parameters,
    pictures,
    propose,
    scenes,
    trials,
)
from fivebar.twin.config import Config
from fivebar.twin.errors import TwinError
from fivebar.twin.messages import Message, encode, topic
from fivebar.twin.soak import BEGIN, configured, machine

BASE = {name: value for name, value in trials.MACHINE.items() if name != "friction.enabled"}
"""Unknowns without dry friction, the most expensive effect."""


SINKING = BASE | {"servo.enabled": False, "viscous.enabled": False, "gravity.g": 0.3}
"""A slow motion under little weight and no other force: it determines only proportions of the masses."""


def made(
    library: Library,
    names: list[str],
    truth: list[float],
    seconds: float,
    noise: float = 1e-4,
    servo: bool = True,
    more: dict[str, float | bool] | None = None,
    base: dict[str, float | bool] | None = None,
) -> dict[str, np.ndarray]:
    """Columns of a record of a machine with the given unknowns."""
    base = (base or (BASE if servo else SINKING)) | (more or {})
    machine = motion.Machine(library, base, parameters.parameters(names, library, base))
    machine.tolerance(1e-10)
    time, commands = trials.path(seconds)
    commanded = trials.NAMES if servo else ()
    samples = data.Samples(time, np.zeros((len(time), 2)), commands if servo else commands[:, :0], commanded)
    path = motion.Path(samples, "rate", library, trials.PERIOD)
    begin = (*trials.BEGIN, 0.0, 0.0) if servo else (2.2, 0.94, 0.0, 0.0)
    moved, _ = machine.run(path, np.array(truth), motion.Start(np.array(begin), 1))
    angles = machine.seen(path, moved, np.array(truth)) + noise * np.random.default_rng(1).standard_normal(
        (len(time), 2)
    )
    machine.close()
    return {
        "time": time,
        "measured.theta[1]": angles[:, 0],
        "measured.theta[2]": angles[:, 1],
        **dict(zip(commanded, commands.T, strict=False)),
    }


def write(file: Path, columns: dict[str, np.ndarray]) -> Path:
    """Writes CSV; NaN becomes an empty cell."""
    rows = [",".join(columns)] + [
        ",".join("" if math.isnan(x) else repr(float(x)) for x in row) for row in zip(*columns.values(), strict=True)
    ]
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return file


def sought(names: list[str]) -> list[str]:
    """Options of the command that name the unknowns."""
    return [word for name in names for word in ("--parameters", name)]


def calibrated(
    fmu: Path,
    file: Path,
    tmp_path: Path,
    names: list[str],
    *more: str,
    base: dict[str, float | bool] | None = None,
    proposal: bool = False,
) -> tuple[int, dict]:
    """Runs the command, with a proposed motion only on request: planning one takes as long as a fit. Returns exit code and results."""
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps({"description": "before"} | (base or BASE)), encoding="utf-8")
    code = main(
        [
            "calibrate",
            str(file),
            "--fmu",
            str(fmu),
            "--scene",
            str(scene),
            "--out",
            str(tmp_path / "out"),
            *sought(names),
            *([] if proposal else ["--no-proposal"]),
            *more,
        ]
    )
    return code, json.loads((tmp_path / "out" / "calibration.json").read_text(encoding="utf-8"))


def test_unknowns_are_found_within_their_bars(fmu: Path, library: Library, tmp_path: Path) -> None:
    """For white noise the error bars reach the Cramér–Rao bound. The written scene contains the found values and the settings of estimator and
    solver, and can be read."""
    names = ["payload.mass", "link[2,3].mass", "viscous.b"]
    columns = made(library, names, [1.2, 0.9, 1.3], 1.5)
    settings = {"estimator.sigma[1]": 2e-4, "estimator.torqueScale": 0.3, "solver.errorTolerance": 1e-7}
    code, figures = calibrated(fmu, write(tmp_path / "a.csv", columns), tmp_path, names, base=BASE | settings)
    assert code == 0
    for name, truth in (("payload.mass", 1.2 * 0.02), ("link[2,3].mass", 0.9 * 0.017), ("viscous.b", 1.3e-4)):
        unknown = figures["unknowns"][name]
        value, bar, bound = (next(iter(unknown[key].values())) for key in ("value", "bar95", "bound95"))
        # Four standard deviations: one of some 16,000 is further off.
        assert unknown["identified"] and abs(value - truth) < 4 / 1.96 * bar and bound <= bar < 1.5 * bound
        assert unknown["derivative_error"] < 1e-2
    written = scenes.values(tmp_path / "out" / "calibrated.json", library)
    assert written["payload.mass"] == figures["unknowns"]["payload.mass"]["value"]["payload.mass"]
    # A link's inertia goes with its mass.
    assert math.isclose(written["link[2].inertia"] / 6.23e-5, written["link[2].mass"] / 0.017, rel_tol=1e-12)
    content = json.loads((tmp_path / "out" / "calibrated.json").read_text(encoding="utf-8"))
    assert settings.items() <= content.items() and not content.keys() & {"estimator.sigma[2]", "solver.method"}
    assert {path.name for path in (tmp_path / "out").glob("*.png")} == {"residuals.png", "unknowns.png"}


def test_the_function_finds_what_the_command_finds(
    fmu: Path, library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Input may be a file, a dict of columns or a data frame, with time as column or index, all with equal samples; nothing is printed."""
    monkeypatch.setenv("FIVEBAR_FMU", str(fmu))
    names = ["payload.mass", "link[2,3].mass", "friction.coulomb[1]"]
    columns = made(library, names[:2], [1.2, 0.9], 1.2)
    file = write(tmp_path / "a.csv", columns)
    code, figures = calibrated(fmu, file, tmp_path, names)
    command, scene = capsys.readouterr(), tmp_path / "scene.json"
    assert code == 0
    frame = pandas.DataFrame(columns)
    records = [
        calibration.prepare(given, scene, names, library, 0.0, 10.0, "").record.series
        for given in (
            file,
            columns,
            {name: list(column) for name, column in columns.items()},
            frame,
            frame.set_index("time"),
        )
    ]
    for [series] in records:
        for one, other in zip(vars(series).values(), vars(records[0][0]).values(), strict=True):
            assert np.array_equal(one, other)
    for record_of in (str(file), frame.set_index("time")):
        found = fivebar.calibrate(record_of, scene, names)
        assert capsys.readouterr() == ("", "")
        assert found.figures() == {name: figures[name] for name in found.figures()}
        assert found.summary() in command.out
    known = {name: unknown for name, unknown in figures["unknowns"].items() if unknown["identified"]}
    for key, offered in (("value", found.values), ("bar95", found.bars), ("bound95", found.bounds)):
        assert offered == {member: x for unknown in known.values() for member, x in unknown[key].items()}
    assert set(found.values) == set(found.units) == {"payload.mass", "link[2].mass", "link[3].mass"}
    assert found.correlations["payload.mass"]["link[2,3].mass"] == figures["correlations"]["payload.mass"][1]
    assert found.not_identified == figures["not_identified"] != []
    written, again = scenes_of.read(tmp_path / "out" / "calibrated.json", library.known), found.scene()
    assert again.values == written.values and again.stop_time == written.stop_time
    assert again.description == written.description.replace("a.csv", "the record")
    stored = pickle.loads(pickle.dumps(found))
    assert stored.figures() == found.figures() and stored.scene() == again
    assert [file.name for file in stored.pictures(tmp_path / "new" / "folder")] == ["residuals.png", "unknowns.png"]
    with pytest.raises(FrozenInstanceError):
        found.solution = None  # type: ignore[misc]


@pytest.mark.parametrize(
    ("change", "more", "sentence"),
    [
        ({"time": None}, {}, "the record has no column time (s); it has measured.theta[1], measured.theta[2], servo.theta[1], "),
        ({"time": [0.0, 1.0]}, {}, "the record has 2 values of time but "),
        ({"measured.theta[1]": ["a", "b"]}, {}, "the record: measured.theta[1] must be a column of numbers, not ["),
        ({"measured.theta[1]": None, "measured.theta[2]": None}, {}, "the record has no column measured.theta[1] or measured.theta[2]; its columns are time, servo."),
        ({}, {"commands": "cubic"}, "commands are 'cubic'; one of rate, linear, hold is needed"),
        ({}, {"patience": 0}, "patience is 0; more than 0 is needed"),
        ({}, {"seconds": math.nan}, "seconds is nan; more than 0 is needed"),
        ({}, {"parameters": ["mass"]}, "mass cannot be sought: "),
        ({}, {"longest": None}, "'longest' must be a number in s, not null"),
        ({}, {"begin": 9.0}, "the record has no sample between 9 s and 19 s"),
        (None, {}, "a record is a file, a dict of columns or a frame of pandas, not 3"),
    ],
)  # fmt: skip
def test_the_function_refuses_in_one_sentence(
    change: dict[str, object] | None, more: dict[str, object], sentence: str, fmu: Path, library: Library
) -> None:
    columns = made(library, ["payload.mass"], [1.2], 1.2) | (change or {})
    record = 3 if change is None else {name: column for name, column in columns.items() if column is not None}
    with pytest.raises(fivebar.FiveBarError, match="^" + re.escape(sentence)):
        fivebar.calibrate(record, {"payload.enabled": True}, **({"parameters": ["payload.mass"]} | more), fmu=fmu)  # type: ignore[arg-type]


def test_no_scene_if_nothing_is_identified(fmu: Path, library: Library) -> None:
    columns = made(library, SCALE, [1.2, 1.0, 1.0, 1.0, 1.0, 1.0], 1.2, base=WEIGHTLESS)
    found = fivebar.calibrate(columns, WEIGHTLESS, SCALE, fmu=fmu)
    assert found.values == {} and repr(found) == "<fivebar calibration: nothing is identified>"
    with pytest.raises(fivebar.FiveBarError, match="^the record identifies nothing: there is no calibrated scene"):
        found.scene()


def driven(library: Library, base: dict[str, float | bool], seconds: float) -> dict[str, np.ndarray]:
    """Columns of a record of a machine driven by torques that are constant between samples."""
    time = np.arange(0.0, seconds + trials.PERIOD / 2, trials.PERIOD)
    torques = 0.02 * np.column_stack([np.sin(9.0 * time), np.cos(7.0 * time)])
    samples = data.Samples(time, np.zeros((len(time), 2)), torques, ("tau[1]", "tau[2]"))
    device = motion.Machine(library, base, [])
    device.tolerance(1e-10)
    path = motion.Path(samples, "hold", library, trials.PERIOD)
    moved, _ = device.run(path, np.empty(0), motion.Start(np.array([2.2, 0.94, 0.0, 0.0]), 1))
    device.close()
    angles = moved[:, :2] + 1e-4 * np.random.default_rng(1).standard_normal((len(time), 2))
    columns = {f"measured.theta[{i + 1}]": angles[:, i] for i in (0, 1)}
    return {"time": time} | columns | {f"tau[{i + 1}]": torques[:, i] for i in (0, 1)}


@pytest.mark.parametrize("between", ["rate", "linear", "hold"])
def test_a_run_takes_the_steps_of_a_live_unit(library: Library, between: motion.Between) -> None:
    """The bits are equal, both for torques and for servo commands with rates."""
    for columns in (made(library, ["payload.mass"], [1.0], 0.2), driven(library, SINKING, 0.2)):
        names = tuple(name for name in columns if name.startswith(("servo", "tau")))
        samples = data.Samples(
            columns["time"],
            np.zeros((len(columns["time"]), 2)),
            np.column_stack([columns[name] for name in names]),
            names,
        )
        path = motion.Path(samples, between, library, trials.PERIOD)
        device = motion.Machine(library, BASE, [])
        moved, _ = device.run(path, np.empty(0), motion.Start(np.array([*trials.BEGIN, 0.0, 0.0]), 1))
        start = dict(zip(motion.SHOWN, (*trials.BEGIN, 0.0, 0.0), strict=True))
        device.unit.reset(
            0.0,
            **(BASE | motion.METHOD | {f"init.{name}": value for name, value in start.items()}),
            **path.first(np.zeros(2), np.ones(2)),
        )
        for k, time in enumerate(path.knots[1:].tolist()):
            device.unit.update(dict(zip(names, path.commands[k].tolist(), strict=True)))
            device.unit.ramp(dict(zip(names, path.slopes[k].tolist(), strict=True)))
            device.unit.step_to(time)
            assert moved[k + 1].tolist() == device.unit.numbers(motion.SHOWN), (between, k)
        device.close()


def test_the_usual_unknowns_of_a_record_take_few_runs(fmu: Path, library: Library, tmp_path: Path) -> None:
    """The record has 10 s and 15 unknowns. Central differences and all shortest pieces would take 6,969 runs."""
    file = played(tmp_path, fmu, library, "pick_and_place", 2000)
    words = ["--fmu", str(fmu), "--scene", "pick_and_place", "--out", str(tmp_path / "out"), "--no-proposal"]
    assert main(["calibrate", str(file), *words]) in (0, 1)
    figures = json.loads((tmp_path / "out" / "calibration.json").read_text(encoding="utf-8"))
    assert len(figures["unknowns"]) == 15 and figures["runs"] < 3500


def test_torque_constants_are_found_from_currents(fmu: Path, library: Library, tmp_path: Path) -> None:
    """A record has currents instead of torques: weights and inertias of the scene determine 0.05 and 0.08 N.m/A."""
    columns = driven(library, SINKING, 1.5)
    for i, constant in ((1, 0.05), (2, 0.08)):
        columns[f"tau[{i}]"] = columns[f"tau[{i}]"] / constant
    names = ["torque.constant[1]", "torque.constant[2]"]
    code, figures = calibrated(
        fmu, write(tmp_path / "a.csv", columns), tmp_path, names, "--commands", "hold", base=SINKING
    )
    assert code == 0
    for name, truth in zip(names, (0.05, 0.08), strict=True):
        value, bar = (figures["unknowns"][name][key][name] for key in ("value", "bar95"))
        assert figures["unknowns"][name]["unit"] == "N.m/A" and abs(value - truth) < 4 / 1.96 * bar < 0.02 * truth
    # The scene's torques at the start are in N.m.
    written = scenes_of.read(tmp_path / "out" / "calibrated.json", library.known)
    assert written["tau[2]"] == pytest.approx(0.02, rel=0.02)
    with pytest.raises(TwinError, match=r"^torque.constant\[2\] is sought twice"):
        parameters.parameters(["torque.constant", "torque.constant[2]"], library, SINKING)


def test_a_tilt_is_found_from_an_upright_start(library: Library) -> None:
    """The fit starts from an upright machine, where the derivative with respect to tilt is 0."""
    names = ["gravity.tilt", "link[2,3].mass"]
    columns = made(library, names, [(1.2 - math.pi / 2) / parameters.MUCH_ANGLE, 0.95], 1.5, servo=False)
    found = fivebar.calibrate(columns, SINKING, names, fmu=library.fmu)
    assert abs(found.values["gravity.tilt"] - 1.2) < 4 / 1.96 * found.bars["gravity.tilt"] < 0.02


def test_stages_report_their_unknowns(
    fmu: Path, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """First gravity in another direction and friction, then masses."""
    names = ["link[2,3].mass", "viscous.b", "gravity.direction"]
    turned = (-1.2 + math.pi / 2) / parameters.MUCH_ANGLE
    columns = made(library, names, [0.9, 3.0, turned], 2.0)
    code, figures = calibrated(fmu, write(tmp_path / "a.csv", columns), tmp_path, names)
    stages = figures["stages"]
    assert code == 0 and [stage["name"] for stage in stages[:3]] == [
        "gravity",
        "drives and friction",
        "masses and geometry",
    ]
    assert [stage["seconds"] for stage in stages] == [0.1, 0.1, 0.1, 0.5, 2.0]
    assert all(stage["after"] < 0.9 * stage["before"] for stage in stages[:3])
    # The noise of `made` is 0.1 mrad. Pieces that started in the wrong assembly would leave 2 mrad.
    assert stages[2]["after"] < 1.1e-4 and stages[-1]["after"] < 1.1e-4
    printed = capsys.readouterr()
    assert (
        re.search(r"gravity, pieces of 0\.1 s: residuals of \S+ mrad become \S+ mrad", printed.out)
        and "gravity, " in printed.err
    )


@pytest.mark.parametrize(
    ("how", "sentence"),
    [
        ("weightless", "the record shows no gravity in the plane (gravity.enabled): over pieces of 0.1 s, "),
        ("from the left", "gravity.direction seems to be near 3.1 rad: "),
        ("held", "measured.theta[1] stands still within 0.15 mrad: a drive that holds it, or friction, is missing"),
        ("reversed", "tau[2] seems to have the wrong sign: "),
        ("in mN.m", "the values of tau[1] and tau[2] seem to be in mN.m; N.m is expected: "),
    ],
)
def test_wrong_assumptions_are_named_before_the_long_fits(how: str, sentence: str, library: Library) -> None:
    """Masses in the scene are wrong as well. Without these warnings the fit took minutes and identified nothing."""
    names, scene = ["payload.mass", "link[2,3].mass", "viscous.b"], BASE
    if how in ("reversed", "in mN.m"):
        names, scene = names[:2], SINKING
        columns = driven(library, SINKING, 1.2)
        if how == "reversed":
            columns["tau[2]"] *= -1
        else:
            columns |= {name: 1e3 * columns[name] for name in ("tau[1]", "tau[2]")}
    else:
        more = {"weightless": {"gravity.enabled": False}, "from the left": {"gravity.direction": 3.1}}.get(how)
        columns = made(library, names, [1.2, 0.8, 1.2], 2.0 if how == "held" else 1.2, more=more)
    if how == "held":
        columns = {name: column for name, column in columns.items() if not name.startswith("servo")}
        columns["measured.theta[1]"] = 1.9 + 1e-4 * np.random.default_rng(0).standard_normal(len(columns["time"]))
        scene = BASE | {"servo.enabled": False}
    said: list[str] = []
    problem = calibration.prepare(columns, scene, names, library, 0.0, 10.0, "")
    with pytest.raises(TwinError, match="^" + re.escape(sentence)):
        problem.solve("rate", 10.0, 120.0, said.append)
    assert said and all("pieces of 0.1 s" in line for line in said)


def test_an_axis_at_rest_is_not_blamed_for_the_other_encoder(
    fmu: Path, library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clamp holds the left motor of `stiff_servo`, as the scene says: large residuals of encoder 2 are no missing drive on motor 1."""
    file = played(tmp_path, fmu, library, "stiff_servo", 240)
    problem = calibration.prepare(file, "stiff_servo", ["link[2].mass"], library, 0.0, 10.0, "")
    machine = motion.Machine(library, problem.assumed.machine, problem.sought)
    fitter = fit.Fitter(machine, problem.record, "rate", 10.0, lambda _: None)
    monkeypatch.setattr(fit.Fitter, "under", lambda *_: math.inf)
    assert float(np.ptp(problem.record.series[0].angles[:, 0])) == 0.0
    fitter.doubt(1, np.array([1e-5, 1e-2]), np.eye(1), [0.1])
    with pytest.raises(TwinError, match=r"^measured.theta\[1\] stands still within 0 mrad: a drive that holds it"):
        fitter.doubt(1, np.array([1e-2, 1e-5]), np.eye(1), [0.1])
    machine.close()


@pytest.mark.parametrize(("swing", "stands"), [(0.0, True), (0.05, False)])
def test_only_an_axis_that_hardly_moves_stands_still(swing: float, stands: bool) -> None:
    """Swapped encoders and torques in mN.m leave residuals of 0.6 rad, of which motions of 0.1 rad are a small part."""
    time = 0.005 * np.arange(400)
    angles = np.column_stack([1.0 + swing * np.sin(5 * time), np.sin(5 * time)])
    angles += 1e-4 * np.random.default_rng(0).standard_normal(angles.shape)
    series = data.Samples(time, angles, np.empty((400, 0)), ())
    sentence = assumptions.held(data.Data([series], []), np.array([0.6, 0.6]))
    assert sentence.startswith("measured.theta[1] stands still within 0.1") if stands else sentence == ""


def test_rough_data(fmu: Path, library: Library, tmp_path: Path) -> None:
    """Outliers, missing readings, lost samples, a gap, a delay of 7 ms and offsets, all at once."""
    names = ["payload.mass", "encoder.offset[1]", "encoder.offset[2]", "encoder.delay"]
    columns = made(library, names, [1.1, 0.05, -0.1, 0.35], 2.5)
    chance = np.random.default_rng(2)
    for i in (1, 2):
        angle = columns[f"measured.theta[{i}]"]
        angle[chance.random(len(angle)) < 0.01] += 0.2
        angle[chance.random(len(angle)) < 0.02] = np.nan
    kept = chance.random(len(columns["time"])) > 0.05
    kept[240:290] = False
    kept[:9] = True
    columns = {name: column[kept] for name, column in columns.items()}
    code, figures = calibrated(fmu, write(tmp_path / "a.csv", columns), tmp_path, names)
    assert code == 0 and figures["series"] == 2 and 3 <= figures["outliers"] <= 20
    for name, truth in zip(names, (0.022, 0.01, -0.02, 0.007), strict=True):
        value, bar = (next(iter(figures["unknowns"][name][key].values())) for key in ("value", "bar95"))
        assert abs(value - truth) < 4 / 1.96 * bar, name


def test_commands_of_a_slower_series_have_no_lost_samples(library: Library) -> None:
    """Two series of 5 and 20 ms: each run has the commands of its own samples, without invented ones between them."""
    columns = made(library, [], [], 1.0)
    both = {name: np.concatenate([column, column[::4]]) for name, column in columns.items()}
    problem = calibration.prepare(both, BASE, ["payload.mass"], library, 0.0, 10.0, "")
    machine = motion.Machine(library, problem.assumed.machine, problem.sought)
    fitter = fit.Fitter(machine, problem.record, "hold", 10.0, lambda _: None)
    assert [series.period for series in problem.record.series] == pytest.approx([0.005, 0.02])
    for length in (0.5, 10.0):
        for part in fitter.cut(length):
            path = fitter.piece(part, motion.Start(np.zeros(4), 1)).path
            assert len(path.knots) == len(part) and path.knots == pytest.approx(part.time - part.time[0])
    machine.close()


def test_the_delay_of_commands_is_found_and_written(fmu: Path, library: Library, tmp_path: Path) -> None:
    """17.3 ms, between two samples, also with other unknowns; the commands before a series are unknown, so that its first 0.1 s are not compared."""
    names = ["servo.delay", "payload.mass", "servo.kp"]
    columns = made(library, names, [0.0173 / 0.02, 1.2, 0.7], 2.0)
    code, figures = calibrated(fmu, write(tmp_path / "a.csv", columns), tmp_path, names)
    assert code == 0 and figures["stages"][0]["name"] == "delay"
    for name, truth in zip(names, (0.0173, 0.024, 1.4), strict=True):
        value, bar = (next(iter(figures["unknowns"][name][key].values())) for key in ("value", "bar95"))
        assert abs(value - truth) < 4 / 1.96 * bar, name
    assert figures["unknowns"]["servo.delay"]["bar95"]["servo.delay"] < 1e-3
    written = scenes.values(tmp_path / "out" / "calibrated.json", library)
    assert written["servo.delay"] == figures["unknowns"]["servo.delay"]["value"]["servo.delay"]


@pytest.mark.parametrize("delay", [0.005, 0.0173, 0.1])
def test_commands_that_act_late_are_those_of_the_unit(library: Library, delay: float) -> None:
    """A part of a series moves as the unit does that was given all commands.

    A ramp stands still over each macro step of 1 ms, and these steps begin at other times: 6e-5 rad/s were measured, and 1 µrad.
    """
    columns = made(library, [], [], 0.5)
    names = tuple(name for name in columns if name.startswith("servo"))
    commands = np.column_stack([columns[name] for name in names])
    samples = data.Samples(columns["time"], np.zeros((len(commands), 2)), commands, names)
    base = BASE | {"servo.delay": delay, "solver.errorTolerance": 1e-10}
    device = motion.Machine(library, base, [])
    device.tolerance(1e-10)
    unit = device.unit
    path = motion.Path(samples, "rate", library, trials.PERIOD)
    start = dict(zip((f"init.{name}" for name in motion.SHOWN), (*trials.BEGIN, 0.0, 0.0), strict=True))
    unit.reset(0.0, **(base | motion.METHOD | start), **path.first(np.zeros(2), np.ones(2)))
    shown = [unit.numbers(motion.SHOWN)]
    for k, time in enumerate(path.knots[1:].tolist()):
        unit.update(dict(zip(names, path.commands[k].tolist(), strict=True)))
        unit.ramp(dict(zip(names, path.slopes[k].tolist(), strict=True)))
        unit.step_to(time)
        shown.append(unit.numbers(motion.SHOWN))
    middle = 30
    for first in (0, middle):
        part = samples.part(first, len(samples))
        moved, _ = device.run(
            motion.Path(part, "rate", library, trials.PERIOD), np.empty(0), motion.Start(np.array(shown[first]), 1)
        )
        apart = np.abs(moved - np.array(shown[first:]))
        assert apart[:, :2].max() < 1e-5 and apart[:, 2:].max() < 2e-4, first
    device.close()


def test_series_of_a_clock_that_restarts_are_fitted_together(fmu: Path, library: Library, tmp_path: Path) -> None:
    """Two records with equal times in one file: no row is left out, and each is a series."""
    names = ["payload.mass", "link[2,3].mass"]
    first, second = (made(library, names, [1.2, 0.9], seconds) for seconds in (1.5, 1.2))
    columns = {name: np.concatenate([first[name], second[name]]) for name in first}
    code, figures = calibrated(fmu, write(tmp_path / "a.csv", columns), tmp_path, names)
    assert code == 0 and figures["series"] == 2 and figures["samples"] == len(columns["time"])
    # The noise of `made` is 1e-4 rad; fitting both series together adds no residual.
    assert max(figures["residuals_rad"]["encoder"]) < 1.2e-4
    for name, truth in (("payload.mass", 1.2 * 0.02), ("link[2,3].mass", 0.9 * 0.017)):
        value, bar = (next(iter(figures["unknowns"][name][key].values())) for key in ("value", "bar95"))
        assert abs(value - truth) < 4 / 1.96 * bar, name


def test_a_run_is_calibrated_as_it_was_written(fmu: Path, tmp_path: Path) -> None:
    """In `fivebar run` commands are constant between communication points; calibration reads its table unchanged."""
    common = ["--fmu", str(fmu), "--out"]
    assert main(["run", "pick_and_place", "--no-pictures", *common, str(tmp_path / "run")]) == 0
    file = tmp_path / "run" / "pick_and_place.csv"
    words = ["--scene", "pick_and_place", "--commands", "hold", "--no-proposal", *sought(["payload.mass"])]
    assert main(["calibrate", str(file), *words, *common, str(tmp_path / "out")]) == 0
    figures = json.loads((tmp_path / "out" / "calibration.json").read_text(encoding="utf-8"))
    # Calibration takes another step than the run's i3alp: measured difference 1.2e-8 rad.
    assert figures["series"] == 1 and max(figures["residuals_rad"]["encoder"]) < 1e-7


def test_unidentifiable_parameters_are_refused_and_named(
    fmu: Path, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Free fall does not determine a common factor of the masses; a motion led by servos would."""
    names = ["payload.mass", "link.mass", "encoder.offset[1]"]
    columns = made(library, names, [1.0, 1.0, 0.01], 1.2, servo=False)
    code, figures = calibrated(fmu, write(tmp_path / "a.csv", columns), tmp_path, names, base=SINKING, proposal=True)
    unknowns = figures["unknowns"]
    assert (
        not unknowns["payload.mass"]["identified"]
        and unknowns["payload.mass"]["value"] is None
        and not unknowns["link.mass"]["identified"]
    )
    # The refusal comes with the first longer pieces, not after minutes.
    assert "these pieces identify 2 of 3 combinations of the unknowns" in capsys.readouterr().err
    (sentence,) = figures["not_identified"]
    assert re.fullmatch("a common factor of (payload.mass, link.mass|link.mass, payload.mass): .*", sentence), sentence
    assert code == (0 if unknowns["encoder.offset[1]"]["identified"] else 1)
    assert {"payload.mass", "link.mass"} <= figures["proposal"]["tells"].keys()
    assert (tmp_path / "out" / "proposal.json").is_file()


CALIBRATED = ("pick_and_place", "fall_90_120", "servo_step", "haptic", "swing")
"""Shipped scenes with stiff servos, with soft ones, and without a drive."""

SCALE = ["payload.mass", "link.mass", "servo.kp", "servo.kd", "servo.limit", "viscous.b"]
"""All torques of a weightless machine: its motion determines only their proportions."""

WEIGHTLESS = BASE | {"gravity.enabled": False}


def test_parameters_that_are_not_identified_keep_the_scene_s_value(fmu: Path, library: Library, tmp_path: Path) -> None:
    """The payload is off by a fifth; servo gains that absorbed a part of it must not be written."""
    columns = made(library, [*SCALE, OFFSETS[0]], [1.2, 1.0, 1.0, 1.0, 1.0, 1.0, 0.05], 1.2, base=WEIGHTLESS)
    code, figures = calibrated(fmu, write(tmp_path / "a.csv", columns), tmp_path, [*SCALE, OFFSETS[0]], base=WEIGHTLESS)
    identified = {name for name, unknown in figures["unknowns"].items() if unknown["identified"]}
    assert code == 0 and identified == {OFFSETS[0]}
    file = tmp_path / "out" / "calibrated.json"
    written, before = scenes_of.read(file, library.known), scenes_of.read(tmp_path / "scene.json", library.known)
    assert written.offsets[OFFSETS[0]] == pytest.approx(0.01, abs=1e-3)
    for name in library.variables:
        if name.startswith(("payload.", "link[", "servo.k", "servo.limit", "viscous.")):
            assert written[name] == before[name], name
    assert "Not identified, with values as before: payload.mass, link.mass, " in written.description


def test_no_scene_is_written_from_an_uninformative_record(
    fmu: Path, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Scenes of an earlier record are removed, so that `fivebar unit` does not use them, unless the fit starts from one."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "calibrated.json").write_text(json.dumps({"description": "before"} | SINKING), encoding="utf-8")
    (out / "proposal.json").write_text("{}", encoding="utf-8")
    names = ["payload.mass", "link.mass"]
    file = write(tmp_path / "a.csv", made(library, names, [1.0, 1.0], 1.2, servo=False))
    common = ["calibrate", str(file), "--fmu", str(fmu), "--out", str(out), "--no-proposal", *sought(names)]
    assert main([*common, "--scene", str(out / "calibrated.json")]) == 1
    assert "calibrated.json is not written: nothing is identified" in capsys.readouterr().out
    assert (out / "calibrated.json").exists() and not (out / "proposal.json").exists()
    (tmp_path / "scene.json").write_bytes((out / "calibrated.json").read_bytes())
    assert main([*common, "--scene", str(tmp_path / "scene.json")]) == 1
    assert not (out / "calibrated.json").exists()


def test_a_value_at_its_bound_is_not_identified(
    fmu: Path, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A payload of 0.4 g ± 9.3 g is not identified, and an impossible machine is named."""
    base, names = BASE | {"link[4].inertia": 2e-4}, ["payload.mass", "viscous.b"]
    file = write(tmp_path / "a.csv", made(library, names, [0.0, 1.2], 1.2, base=base))
    code, figures = calibrated(fmu, file, tmp_path, names, base=base)
    [impossible] = figures["impossible"]
    printed = capsys.readouterr()
    assert "fivebar calibrate: warning: scene: link[4].inertia is 0.0002 kg.m2 about the centre of mass" in printed.err
    assert f"warning: {impossible}" in printed.out.splitlines()
    unknowns = figures["unknowns"]
    assert code == 0 and unknowns["viscous.b"]["identified"] and not unknowns["payload.mass"]["identified"]
    assert re.fullmatch(
        r"payload\.mass: at its bound of 0 kg, below \S+ kg with 95 % probability", figures["not_identified"][0]
    )
    assert scenes_of.read(tmp_path / "out" / "calibrated.json", library.known)["payload.mass"] == BASE["payload.mass"]


def test_lengths_that_are_not_identified_are_the_scenes(library: Library) -> None:
    """Without weight a larger, lighter machine moves alike. Masses depend on the scene's lengths, and their error bars include this."""
    names = ["payload.mass", "link.mass", "link.length", "base.distance"]
    truth = np.array([1.2, 0.9, 1.001, 1.001])
    unknowns = parameters.parameters(names, library, WEIGHTLESS)
    columns = made(library, names, truth.tolist(), 1.2, base=WEIGHTLESS)
    samples = data.split(recording.of("a record", columns.pop("time"), columns, []))
    device = motion.Machine(library, WEIGHTLESS, unknowns)
    free, result = (
        calibration.solve(device, samples, "rate", 10.0, lambda _: None, taken=taken)
        for taken in (None, parameters.trusted(unknowns, library))
    )
    device.close()
    assert not any(free.judgement.identified)
    assert result.judgement.identified == [True, True, False, False]
    off, bars = np.abs(result.fit.x - truth)[:2], result.judgement.sigma[:2]
    # Lengths off by 0.1 % make masses off by 0.2 %; noise alone would give error bars of 0.001 %.
    assert np.all(off < 4 * bars) and np.all((bars > 1e-3) & (bars < 5e-3))
    assert "link.length: the record is less accurate than the scene, " in result.judgement.not_identified(unknowns)[0]


@pytest.mark.parametrize("sought_too", [[], ["link[2,3].com"]])
def test_a_length_changes_the_inertia_unless_the_centre_of_mass_is_sought(
    sought_too: list[str], library: Library
) -> None:
    """Length alone: a longer link of the same shape. With `com`: the same body, its joint moved."""
    scene = {"link[2].com": 0.08, "link[2].inertia": 5e-5}
    unknowns = parameters.parameters(["link[2,3].length", *sought_too], library, scene)
    found = parameters.assemble(scene, library, unknowns, [1.01, *(1.0 for _ in sought_too)])
    assert found["link[2].length"] == pytest.approx(1.01 * 0.21)
    factor = 1.0 if sought_too else 1.01
    assert found["link[2].com"] == pytest.approx(factor * 0.08)
    assert found["link[2].inertia"] == pytest.approx(factor**2 * 5e-5)


def test_values_of_a_link_that_are_not_identified_stay_the_scenes(library: Library) -> None:
    """A centre of mass moved with the link's length into the written scene, and an inertia with its mass, unlike in the fitted machine."""
    scene: parameters.Values = {"link[2].com": 0.08, "link[2].inertia": 5e-5, "link[1].inertia": 4e-5}
    names = ["link[2].length", "link[2].com", "link[3].com", "link[1].mass", "link[1].inertia"]
    unknowns = parameters.parameters(names, library, scene)
    solution = SimpleNamespace(
        sought=unknowns,
        fit=SimpleNamespace(x=np.array([1.01, 1.02, 1.03, 1.04, 1.05])),
        judgement=SimpleNamespace(identified=[True, False, True, True, False]),
    )
    problem = SimpleNamespace(assumed=SimpleNamespace(machine=scene), library=library)
    found = calibration.Calibration(problem, solution).start()  # type: ignore[arg-type]
    assert found["link[2].length"] == pytest.approx(1.01 * 0.21) and found["link[3].com"] == pytest.approx(1.03 * 0.105)
    assert found["link[2].com"] == 0.08 and found["link[2].inertia"] == 5e-5 and found["link[1].inertia"] == 4e-5


def test_derivatives_are_taken_at_the_solution(library: Library) -> None:
    """Derivatives from 0.1 mrad away were wrong by 0.01 to 0.1 % with stiff servos, and no mass was identified."""
    names = ["payload.mass", "link[1,4].mass", "link[2,3].mass"]
    stiff = WEIGHTLESS | {f"servo.{gain}[{i}]": value for gain, value in (("kp", 20.0), ("kd", 0.5)) for i in (1, 2)}
    columns = made(library, names, [1.2, 0.95, 1.05], 1.2, base=stiff)
    device = motion.Machine(library, stiff, parameters.parameters(names, library, stiff))
    fitter = fit.Fitter(
        device, data.split(recording.of("a record", columns.pop("time"), columns, [])), "rate", 10.0, lambda _: None
    )
    found = fitter.run()
    device.close()
    error = np.linalg.norm(found.doubt[:, :3], axis=0) / np.linalg.norm(found.jacobian[:, :3], axis=0)
    # Truncation and round-off of the runs are 1e-9.
    assert np.all(error < 1e-6), error


def test_correlations_are_numbers_whatever_residuals_are(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    """A covariance estimated from correlated residuals may have a negative variance; JSON has no NaN."""
    names = ["payload.mass", "link[1,4].mass"]
    columns = made(library, names, [1.2, 0.95], 1.2)
    unknowns = parameters.parameters(names, library, BASE)
    device = motion.Machine(library, BASE, unknowns)
    samples = data.split(recording.of("a record", columns.pop("time"), columns, []))
    found = fit.Fitter(device, samples, "rate", 10.0, lambda _: None).run()
    device.close()
    monkeypatch.setattr(identify, "together", lambda *_: identify.Together(lag=1, period=0, time_scale=2.0))
    monkeypatch.setattr(identify, "between", lambda *_: -1e9 * np.eye(2))
    judged = identify.judge(found, unknowns, np.full(2, np.inf))
    assert np.all(np.isfinite(judged.correlation)) and np.all(np.diag(judged.correlation) == 1.0)


@pytest.mark.parametrize(
    ("name", "seconds", "sought_here"),
    [
        ("fall_90_120", 1.2, [*(f"link[{i}].mass" for i in (1, 2, 3, 4)), "viscous.b"]),
        *(pytest.param(name, 10.0, [], marks=pytest.mark.nightly) for name in CALIBRATED),
    ],
)
def test_a_twin_and_two_calibrations_find_the_machine(
    name: str,
    seconds: float,
    sought_here: list[str],
    fmu: Path,
    library: Library,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A record, the motion that its calibration proposes, and a record of this motion: masses and payload are within their error bars.

    The short form takes a fall, which determines only proportions of masses, and a machine with the scene's lengths.
    """
    exact = bool(sought_here)
    common = ["--fmu", str(fmu), *sought(sought_here)]
    first = sampled(configured(tmp_path / "first", fmu, library, name, exact=exact), library, seconds)
    # A fit that does not converge ends with a proposed motion that converges.
    assert main(["calibrate", str(first), "--out", str(tmp_path / "before"), *common]) in (0, 1, 2)
    printed = capsys.readouterr().out.splitlines()
    (line,) = (line for line in printed if line.startswith("  fivebar twin "))
    given, length = (shlex.split(line)[k] for k in (3, 5))
    assert shlex.split(line) == ["fivebar", "twin", "--scene", given, "--seconds", length]
    # Same machine as before, except its start and, if it had none, its servos.
    before, proposed = (scenes_of.read(scene, library.known) for scene in (name, given))
    changed = {each for each in library.known.start if before[each] != proposed[each]} - before.signals.keys()
    assert all(each.startswith(("init.", "servo.", "tau[", "tip.f")) for each in changed), changed
    assert not any(proposed[f"{each}[{i}]"] for each in ("tau", "init.omega") for i in (1, 2))
    config = configured(tmp_path / "second", fmu, library, given, exact=exact)
    assert twin_scene.read(Path(config.scene)).periodic
    second = sampled(config, library, propose.SECONDS if exact else float(length))
    assert main(["calibrate", str(second), "--out", str(tmp_path / "after"), *common]) == 0
    figures = json.loads((tmp_path / "after" / "calibration.json").read_text(encoding="utf-8"))
    masses = {each: unknown for each, unknown in figures["unknowns"].items() if each.endswith(".mass")}
    assert masses
    for each, unknown in masses.items():
        assert unknown["identified"], each
        for member, value in unknown["value"].items():
            truth = config.machine.hidden[member]
            # Four standard deviations: one of some 16,000 is further off.
            assert abs(value - truth) < 4 / 1.96 * unknown["bar95"][member], member


@pytest.mark.nightly
def test_one_record_of_a_chaotic_motion_tells_everything(
    fmu: Path, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The springs of `spring_payload` throw the links about: the record identifies each mass to 0.02 %, and no motion identifies more.

    With inertias in proportion to the square of fitted lengths, masses were off by nine error bars.
    """
    config = configured(tmp_path / "first", fmu, library, "spring_payload")
    common = ["--fmu", str(fmu), "--out", str(tmp_path / "out"), "--patience", "500"]
    assert main(["calibrate", str(sampled(config, library, 10.0)), *common]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert "none of the tried motions would identify more" in printed and not (tmp_path / "out/proposal.json").exists()
    figures = json.loads((tmp_path / "out" / "calibration.json").read_text(encoding="utf-8"))
    # Centres of mass are known from the scene as well as from the record, and the machine has no friction.
    unknown = {each for each, found in figures["unknowns"].items() if not found["identified"]}
    assert unknown == {"link[1,4].com", "link[2,3].com", "friction.coulomb[1,5]"}
    for each in unknown:
        assert any(line.startswith(f"not identified: {each}: ") for line in printed), each
    for each, found in figures["unknowns"].items():
        for member, value in (found["value"] or {}).items():
            truth = config.machine.hidden.get(member)
            # Four standard deviations: one of some 16,000 is further off.
            assert truth is None or abs(value - truth) < 4 / 1.96 * found["bar95"][member], member
    assert figures["unknowns"]["payload.mass"]["bar95"]["payload.mass"] < 1e-4
    written = scenes_of.read(tmp_path / "out" / "calibrated.json", library.known)
    for i in (1, 2, 3, 4):
        assert written[f"link[{i}].com"] == 0.105
        # With the inertia in proportion to the square of the length it would be 2e-3 off.
        assert written[f"link[{i}].inertia"] == pytest.approx(config.machine.hidden[f"link[{i}].inertia"], rel=1e-3)


@pytest.mark.nightly
def test_what_no_motion_tells_is_named(
    fmu: Path, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A drive of 1e6 N.m/rad clamps the left link of `stiff_servo`: its mass moves nothing, and no force measures the others."""
    config = configured(tmp_path / "first", fmu, library, "stiff_servo", exact=True)
    names = [f"link[{i}].mass" for i in (1, 2, 3, 4)]
    common = ["--fmu", str(fmu), "--out", str(tmp_path / "out"), "--patience", "500", *sought([*names, "viscous.b"])]
    assert main(["calibrate", str(sampled(config, library, 1.2)), *common]) == 1
    printed = capsys.readouterr().out.splitlines()
    refused = [line for line in printed if line.startswith("not identified: ")]
    assert "not identified: link[1].mass: not identified by the record" in refused
    assert all(any(name in line for line in refused) for name in names), refused
    assert "none of the tried motions would identify more" in printed
    assert "calibrated.json is not written: nothing is identified" in printed
    assert not (tmp_path / "out" / "proposal.json").exists()


@pytest.mark.nightly
def test_a_user_finds_the_machine_by_the_commands_that_are_printed(fmu: Path, tmp_path: Path) -> None:
    """Runs `fivebar twin`, `fivebar calibrate` and the command that it prints, with the default scene and unknowns, in real time."""
    environment = os.environ | {"FIVEBAR_FMU": str(fmu)}

    def fivebar(*words: str) -> str:
        command = [sys.executable, "-m", "fivebar", *words]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        # Exit code 3: on a busy machine forecasts may come late.
        assert done.returncode in ((0, 3) if words[0] == "twin" else (0, 1)), done.stdout + done.stderr
        return done.stdout

    records = []
    words = ["twin", "--seconds", "12"]
    for _ in range(2):
        fivebar(*words)
        (new,) = {*(tmp_path / "twin" / "runs").iterdir()} - {*records}
        records.append(new)
        output = fivebar("calibrate", str(new / "record"), "--patience", "500")
        if line := next((line for line in output.splitlines() if line.startswith("  fivebar twin ")), None):
            words = shlex.split(line)[1:]
    figures = json.loads((tmp_path / "calibrate" / "calibration.json").read_text(encoding="utf-8"))
    truth = json.loads((records[-1] / "twin.json").read_text(encoding="utf-8"))["machine"]["hidden"]
    for name in ("payload.mass", *(f"link[{i}].mass" for i in (1, 2, 3, 4))):
        value, bar = (figures["unknowns"][name][key][name] for key in ("value", "bar95"))
        assert abs(value - truth[name]) < 4 / 1.96 * bar, name


def sampled(config: Config, library: Library, seconds: float) -> Path:
    """A record with the samples of a stand-in."""
    source, about = machine(config, library), setup.of_run(config, twin_scene.read(Path(config.scene)), library.guid)
    messages = [about.to_message(config.unit, BEGIN), *(source.next() for _ in range(round(seconds / config.period)))]
    source.close()
    config.record.mkdir()
    rows = [record.Row(topic(m.unit, m.kind), m.time, m.seq, encode(m)) for m in messages]
    record.write_part(config.record, 0, len(rows), rows)
    return config.record


def played(
    folder: Path,
    fmu: Path,
    library: Library,
    name: str,
    samples: int,
    offsets: tuple[float, float] | None = None,
    origin: str = "0",
) -> Path:
    """A table of the samples of a stand-in; times are decimals that start at `origin` s."""
    config = configured(folder, fmu, library, name, exact=True)
    if offsets is not None:
        hidden = {"payload.mass": 0.06} | dict(zip(parameters.OFFSETS, offsets, strict=True))
        config = replace(config, machine=replace(config.machine, hidden=hidden))
    source = machine(config, library)
    names = ["measured.theta[1]", "measured.theta[2]", *(trials.NAMES if source.scene.signals else ())]
    rows = [",".join(["time", *names])]
    for k in range(samples):
        fields = source.next().fields
        rows.append(",".join([str(Decimal(origin) + k * Decimal("0.005")), *(repr(fields[each]) for each in names)]))
    source.close()
    file = folder / "played.csv"
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return file


def test_a_chaotic_motion_is_followed_from_short_pieces_on(fmu: Path, library: Library, tmp_path: Path) -> None:
    """Springs throw the links about, so a guessed start is lost within half a second; the record must not be refused."""
    file = played(tmp_path, fmu, library, "spring_payload", 800)
    out = ["--fmu", str(fmu), "--scene", "spring_payload", "--out", str(tmp_path / "out"), "--no-proposal"]
    names = ["payload.mass", *(f"link[{i}].mass" for i in (1, 2, 3, 4)), "viscous.b"]
    assert main(["calibrate", str(file), *out, *sought(names)]) == 0
    figures = json.loads((tmp_path / "out" / "calibration.json").read_text(encoding="utf-8"))
    assert max(figures["residuals_rad"]["encoder"]) < 1e-4
    for name, truth in (("payload.mass", 0.06), ("link[1].mass", 0.01785), ("link[2].mass", 0.01632)):
        value, bar = (figures["unknowns"][name][key][name] for key in ("value", "bar95"))
        assert abs(value - truth) < 4 / 1.96 * bar, name


@pytest.mark.parametrize(
    ("name", "offsets"),
    [
        ("pick_and_place", (0.01, -0.02)),
        pytest.param("pick_and_place", (-0.015, 0.005), marks=pytest.mark.nightly),
        ("servo_step", (0.01, -0.02)),
    ],
)
def test_offsets_are_those_of_encoders_that_servos_close_on(
    fmu: Path, library: Library, tmp_path: Path, name: str, offsets: tuple[float, float]
) -> None:
    """The error bars contain the true offsets. They did not while servos were assumed to use true angles.

    In `servo_step` the servos hold the scene's angles, and the record has no commands.
    """
    soft = {"servo.enabled": True} | {
        f"servo.{gain}[{i}]": value for gain, value in (("kp", 2.0), ("kd", 0.02)) for i in (1, 2)
    }
    scene = tmp_path / "soft.json"
    shipped = json.loads((Path(__file__).resolve().parents[2] / "scenes" / f"{name}.json").read_text(encoding="utf-8"))
    scene.write_text(json.dumps(shipped | soft), encoding="utf-8")
    file = played(tmp_path, fmu, library, str(scene), 320, offsets)
    assert ("servo.theta[1]" in file.read_text(encoding="utf-8")) == (name == "pick_and_place")
    names = [*(["payload.mass"] if name == "pick_and_place" else []), "link.mass", *parameters.OFFSETS]
    out = ["--fmu", str(fmu), "--scene", str(scene), "--out", str(tmp_path / "out"), "--no-proposal"]
    assert main(["calibrate", str(file), *out, *sought(names)]) == 0
    figures = json.loads((tmp_path / "out" / "calibration.json").read_text(encoding="utf-8"))
    # Encoders of 65,536 counts a turn.
    assert max(figures["residuals_rad"]["encoder"]) < 1e-4
    for offset, truth in zip(parameters.OFFSETS, offsets, strict=True):
        unknown = figures["unknowns"][offset]
        assert unknown["identified"] and abs(unknown["value"][offset] - truth) < 4 / 1.96 * unknown["bar95"][offset]
    if name == "servo_step":
        # The calibrated machine's servos hold the readings that this machine's hold.
        written = scenes_of.read(tmp_path / "out" / "calibrated.json", library.known)
        for i in (1, 2):
            held = written[f"servo.theta[{i}]"] + written.offsets[parameters.OFFSETS[i - 1]]
            assert held == pytest.approx(shipped[f"servo.theta[{i}]"], abs=1e-12)


def springs(turns: int) -> dict[str, float | bool]:
    """Springs at the start angles plus the given number of turns."""
    angles = {f"spring.theta0[{i}]": angle + 2 * math.pi * turns for i, angle in ((1, 2.5), (2, 1.2))}
    return {"spring.enabled": True, "spring.k[1]": 0.1, "spring.k[2]": 0.1} | angles


@pytest.mark.parametrize("lowest", [0.0, 2.3 - 2 * math.pi])
def test_an_encoder_may_count_from_another_turn(
    lowest: float, fmu: Path, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Absolute encoders, one with a jump of a turn, and springs two turns away: the record is still of this machine."""
    columns = made(library, ["payload.mass"], [1.1], 1.5, servo=False, more=springs(0))
    angles = ("measured.theta[1]", "measured.theta[2]")
    absolute = {name: lowest + (columns[name] - lowest) % (2 * math.pi) for name in angles}
    assert (max(np.abs(np.diff(column)).max() for column in absolute.values()) > math.pi) == (lowest < 0)
    # One wrong sample.
    absolute["measured.theta[1]"][40] += 3.2
    scene = SINKING | springs(-2)
    code, found = calibrated(fmu, write(tmp_path / "a.csv", columns | absolute), tmp_path, ["payload.mass"], base=scene)
    unknown = found["unknowns"]["payload.mass"]
    truth = 1.1 * unknown["scene"]["payload.mass"]
    # Tolerance: four standard deviations.
    assert code == 0 and abs(unknown["value"]["payload.mass"] - truth) < 2 * unknown["bar95"]["payload.mass"]
    assert max(found["residuals_rad"]["encoder"]) < 2e-4, "noise of 1e-4 rad"
    assert [note[:17] for note in found["notes"]] == list(angles)
    assert "in the turn nearest to spring.theta0[1] = -10.0664 rad" in capsys.readouterr().out
    begin = json.loads((tmp_path / "out" / "calibrated.json").read_text(encoding="utf-8"))
    assert abs(begin["init.theta[1]"] - (2.2 - 4 * math.pi)) < 1e-3


def test_the_origin_of_time_does_not_matter(fmu: Path, library: Library, tmp_path: Path) -> None:
    """Adding 1e9 s, at which floats have steps of 0.1 us, does not change the verdict."""
    tables = [
        data.read(played(tmp_path, fmu, library, "pick_and_place", 40, origin=origin), 0.0, 10.0).series[0]
        for origin in ("0", "1000000000")
    ]
    assert np.array_equal(tables[0].time, tables[1].time) and np.array_equal(tables[0].angles, tables[1].angles)


def residuals_of(*encoders: np.ndarray) -> dict[str, list[Any]]:
    """Pieces and residuals of a fit, with the given residuals of one encoder, or of both, in two pieces."""
    gaps = np.column_stack([encoders[0], encoders[-1]])
    halves = np.array_split(gaps, 2)
    return {"pieces": [SimpleNamespace(mask=np.isfinite(half)) for half in halves], "residuals": halves}


@pytest.mark.parametrize(("zero", "begin"), [(0.03, "warning: "), (-0.06, "refused: ")])
def test_a_constant_residual_is_a_wrong_zero(zero: float, begin: str) -> None:
    """Missing readings do not count; a residual that changes is no zero."""
    wave = 1e-3 * np.sin(np.arange(100.0))
    off = zero + wave
    off[30] = np.nan
    found = SimpleNamespace(sigma=np.array([1e-4, abs(zero)]), rms_before=abs(zero), **residuals_of(wave, off))
    told = "".join(calibration.suspicion(found, np.array([1e-5, 1e-5])))
    assert told.startswith(f"{begin}residuals of encoder 2 are {round(1e3 * abs(zero))} mrad after the fit")
    assert f"as if the zero of this encoder were {zero:+.4f} rad off" in told
    assert f'(in a map of `fivebar import`, add {-zero:+.4f} to its "offset")' in told
    found.residuals = [gaps * np.sin(np.arange(50.0))[:, None] for gaps in found.residuals]
    told = "".join(calibration.suspicion(found, np.array([1e-5, 1e-5])))
    assert (
        "zero" not in told
        and told.startswith(begin)
        and ("scene is not this machine" in told or "effect that is not fitted" in told)
    )


def test_a_fit_that_fails_is_not_called_another_machine() -> None:
    """If the scene's own values follow short pieces, the scene is of this machine."""
    found = SimpleNamespace(sigma=np.array([1.0, 1.0]), rms_before=1.7e-4, **residuals_of(np.sin(np.arange(50.0))))
    assert calibration.suspicion(found, np.array([1e-6, 1e-6]))[0].startswith(
        "refused: the fit failed: residuals of encoder 1 are 1000 mrad after the fit"
    )
    found.rms_before = 0.2
    assert "the scene is not this machine" in calibration.suspicion(found, np.array([1e-6, 1e-6]))[0]


def test_residuals_of_a_doubtful_fit_are_not_called_white() -> None:
    """White residuals that are too large are no sign of a good fit, and the largest allowed number of outliers is one of a bad fit."""
    found = SimpleNamespace(sigma=np.array([1e-4, 2e-4]), rows=np.zeros((1600, 3)), outliers=3)
    line = "residuals 0.1, 0.2 mrad (encoders 1, 2), 3 outliers left out"
    assert calibration.residuals(found, 1.0, False, False) == f"{line}; the residuals are white"
    assert calibration.residuals(found, 7.0, False, True) == f"{line}; 7 residuals count as one"
    assert calibration.residuals(found, 1.0, False, True) == calibration.residuals(found, 7.0, True, True) == line
    found.outliers = fit.most_outliers(1602)
    found.rows = found.rows[: 1602 - found.outliers]
    assert found.outliers == 81 and ", 81 outliers left out, as many as are allowed" in calibration.residuals(
        found, 1.0, False, True
    )
    usable, size = [np.ones((801, 2), dtype=bool)], [np.arange(1602.0).reshape(801, 2) + 100]
    assert sum(int(mask.sum()) for mask in fit.beyond(usable, size, np.ones(2))) == 81


def test_records_of_the_pipeline(tmp_path: Path) -> None:
    """Samples are sorted by their count; doubled and malformed ones are counted and left out."""
    messages = [
        Message(
            "meas", "bench", 1_000_000_000 + 5_000_000 * k, k, {"measured.theta[1]": 0.1 * k, "servo.theta[1]": 1.0}
        )
        for k in range(30)
    ]
    rows = [record.Row(topic("bench", "meas"), m.time, m.seq, encode(m)) for m in messages]
    rows[3], rows[4] = rows[4], rows[3]
    rows += [rows[7], record.Row(topic("bench", "meas"), 0, 0, b"{")]
    record.write_part(tmp_path, 0, 1, rows)
    found = data.read(tmp_path, 0.0, 10.0)
    assert len(found.series) == 1 and found.period == pytest.approx(0.005)
    assert found.series[0].angles[:, 0].tolist() == pytest.approx([0.1 * k for k in range(30)])
    malformed, doubled = found.notes
    assert malformed.startswith("1 malformed messages left out, the first one because meas is not JSON: ")
    assert doubled == "1 doubled samples"


def test_a_machine_whose_clock_is_set_back_has_series_that_do_not_overlap(tmp_path: Path) -> None:
    """A fit finds its pieces by time: pieces of another series must not be among them."""
    times = [1_000_000_000 + 5_000_000 * (k if k < 30 else k - 25) for k in range(60)]
    messages = [Message("meas", "bench", time, k, {"measured.theta[1]": 0.1 * k}) for k, time in enumerate(times)]
    record.write_part(tmp_path, 0, 1, [record.Row(topic("bench", "meas"), m.time, m.seq, encode(m)) for m in messages])
    first, second = data.read(tmp_path, 0.0, 10.0).series
    assert len(first) == len(second) == 30 and second.time[0] > first.time[-1]


def misused(columns: dict[str, np.ndarray], how: str) -> dict[str, np.ndarray]:
    """Records that a user may give by mistake."""
    angles = ("measured.theta[1]", "measured.theta[2]")
    if how == "still":
        noise = np.random.default_rng(3).standard_normal((2, len(columns["time"])))
        return columns | {name: columns[name][0] + 1e-4 * n for name, n in zip(angles, noise, strict=True)}
    if how == "degrees":
        return {name: np.degrees(column) if "theta" in name else column for name, column in columns.items()}
    if how == "milliseconds":
        return columns | {"time": 1e3 * columns["time"]}
    if how == "swapped":
        return columns | {a: columns[b] for a, b in (angles, angles[::-1])}
    return {name: column[:190] for name, column in columns.items()}


@pytest.mark.parametrize(
    ("how", "sentence"),
    [
        ("still", "the measured angles stand still"),
        ("degrees", "are these degrees?"),
        ("milliseconds", "are these milliseconds?"),
        ("swapped", "are the encoders swapped?"),
        ("short", "the record has 0.945 s; 1 s or more are needed"),
    ],
)
def test_unusable_records_are_refused(
    how: str, sentence: str, fmu: Path, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A record at rest once gave 53.3 ± 1.3 g for 20.07 g with exit code 0; swapped encoders took minutes."""
    names = ["payload.mass"]
    (tmp_path / "scene.json").write_text(json.dumps({"description": "before"} | BASE), encoding="utf-8")
    file = write(tmp_path / "a.csv", misused(made(library, names, [1.1], 1.5), how))
    common = ["--fmu", str(fmu), "--scene", str(tmp_path / "scene.json"), "--out", str(tmp_path / "out")]
    assert main(["calibrate", str(file), *common, *sought(names)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert sentence in line


def test_servos_that_are_on_without_commands_are_warned_of_first(library: Library) -> None:
    """The scene's servos would hold, while the record has torques only; no fit is needed for the warning."""
    columns = {name.replace("servo.theta", "tau"): x for name, x in made(library, ["payload.mass"], [1.0], 1.5).items()}
    columns = {name: x for name, x in columns.items() if not name.startswith("servo")}
    assumed = {"description": "before"} | BASE
    with pytest.warns(
        MachineWarning, match="the scene's servos are on, but the record has .* set servo.enabled to false"
    ):
        calibration.prepare(columns, assumed, ["payload.mass"], library, 0.0, 10.0, "")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        calibration.prepare(columns, assumed | {"servo.enabled": False}, ["payload.mass"], library, 0.0, 10.0, "")


def test_a_record_of_another_machine_is_refused_in_the_first_line(
    fmu: Path, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The machine executes a tenth of its commands: residuals of 0.1 rad are not noise."""
    names = ["payload.mass"]
    columns = made(library, names, [1.1], 1.1)
    for name in ("measured.theta[1]", "measured.theta[2]"):
        columns[name] = np.mean(columns[name]) + 0.1 * (columns[name] - np.mean(columns[name]))
    code, figures = calibrated(fmu, write(tmp_path / "a.csv", columns), tmp_path, names)
    assert code == 1 and figures["unknowns"]["payload.mass"]["value"] is None
    assert capsys.readouterr().out.startswith("refused: residuals of encoder ") and figures["refused"]
    assert not (tmp_path / "out" / "calibrated.json").exists()


def test_an_effect_outside_the_unknowns_is_warned_of_in_the_first_line(
    fmu: Path, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Encoders are late by 20 ms, and the delay is not among the unknowns."""
    columns = made(library, ["payload.mass", "encoder.delay"], [1.1, 1.0], 1.1)
    code, figures = calibrated(fmu, write(tmp_path / "a.csv", columns), tmp_path, ["payload.mass"])
    assert (
        capsys.readouterr().out.startswith("warning: residuals of encoder ")
        and figures["warning"]
        and not figures["refused"]
    )
    assert code in (0, 1)


def test_a_fit_that_does_not_converge_ends(
    fmu: Path, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ["payload.mass", "link[2,3].mass"]
    (tmp_path / "scene.json").write_text(json.dumps({"description": "before"} | BASE), encoding="utf-8")
    file = write(tmp_path / "a.csv", made(library, names, [1.1, 0.9], 1.5))
    common = ["--fmu", str(fmu), "--scene", str(tmp_path / "scene.json"), "--out", str(tmp_path / "out")]
    assert main(["calibrate", str(file), *common, *sought(names), "--patience", "0.05"]) == 2
    printed = capsys.readouterr()
    assert "the fit did not converge within 0.05 s of CPU" in printed.err
    # The motion is planned for the scene's machine, whatever the record is.
    assert "a motion to identify payload.mass to ±" in printed.out and (tmp_path / "out" / "proposal.json").is_file()
    assert "--fmu" not in printed.out


def test_the_time_limit_is_the_given_one_and_keeps_a_finished_fit(
    library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Trials of other assumptions named the rest of the time as the limit; a limit in a repetition dropped the fit before."""
    columns = made(library, [*SCALE, OFFSETS[0]], [1.2, 1.0, 1.0, 1.0, 1.0, 1.0, 0.05], 1.2, base=WEIGHTLESS)
    problem = calibration.prepare(columns, WEIGHTLESS, [*SCALE, OFFSETS[0]], library, 0.0, 10.0, "")
    machine = motion.Machine(library, problem.assumed.machine, problem.sought)
    fitter = fit.Fitter(machine, problem.record, "rate", 10.0, lambda _: None, 100.0)
    fitter.ends = 0.0
    other = fit.assumptions.Assumption("", {}, lambda samples: samples)
    with pytest.raises(fit.TimeLimitExceeded, match=r"^the fit did not converge within 100 s of CPU \(--patience\)"):
        fitter.under(other, 1, np.eye(len(problem.sought)), [0.1], False)
    machine.close()

    def late(*_: object) -> None:
        raise fit.TimeLimitExceeded("late")

    monkeypatch.setattr(fit.Fitter, "again", late)
    said: list[str] = []
    found = problem.solve("rate", 10.0, 100.0, said.append)
    assert any(
        line.startswith("no time is left for this repetition (--patience): the fit before stays") for line in said
    )
    # On `stiff_servo` the first fit alone gave a friction that was off by 13 of its standard deviations.
    assert found.values == {} and max(found.residuals) < 2e-4
    assert "a common factor of " in found.not_identified[0]


def test_the_command_that_is_printed_runs_the_same_unit(
    fmu: Path, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.json").write_text(json.dumps({"description": "before"} | BASE), encoding="utf-8")
    names = ["payload.mass", "link[2,3].mass"]
    file = write(tmp_path / "a.csv", made(library, names, [1.1, 0.9], 1.5))
    other = shutil.copy(fmu, tmp_path / "my unit.fmu")
    common = ["--fmu", str(other), "--scene", str(tmp_path / "scene.json"), "--out", str(tmp_path / "out")]
    assert main(["calibrate", str(file), *common, *sought(names), "--patience", "0.05"]) == 2
    (line,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("  fivebar twin "))
    assert shlex.split(line)[-2:] == ["--fmu", str(other)]


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        (["link[5].mass"], "link[5].mass is not a parameter of the machine"),
        (["solver.stepSize"], "cannot be sought"),
        (["link.mass", "link[1].mass"], "link[1].mass is sought twice"),
    ],
)
def test_names_are_checked(library: Library, names: list[str], sentence: str) -> None:
    with pytest.raises(Exception, match=sentence.replace("[", r"\[").replace("]", r"\]").replace(".", r"\.")):
        parameters.parameters(names, library, {})


def test_the_picture_of_unknowns_shows_identified_ones(library: Library) -> None:
    """Each name appears once, off the grid; no row lies on the frame; correlations only between unknowns with a value."""
    sought = parameters.parameters(["payload.mass", "link.mass", "viscous.b"], library, BASE)
    some = np.ones(3)
    judged = SimpleNamespace(sigma=some, bound=some, correlation=np.eye(3), identified=[True, False, True])
    figure = pictures._unknowns(SimpleNamespace(x=some), judged, sought)
    left, right = figure.axes[:2]
    assert [text.get_text() for text in left.texts] == ["not identified"] and left.get_ylim() == (2.6, -0.6)
    assert [text.get_text() for text in right.get_yticklabels()] == ["payload.mass", "viscous.b"]
    pictures.plt.close(figure)


def test_residuals_that_change_smoothly_are_no_outliers() -> None:
    time = np.linspace(0, 1, 200)
    gap = np.column_stack([np.sin(6 * time), np.cos(6 * time)])
    gap[50, 0] += 0.2
    leaps = np.abs(gap - fit.around(gap))
    assert leaps[50, 0] > 0.19 and np.delete(leaps[:, 0], 50)[5:-5].max() < 0.02


def test_usual_unknowns_are_what_the_scene_has() -> None:
    assert "payload.mass" not in calibration.usual({}) and "gravity.direction" in calibration.usual({})
    assert "gravity.direction" not in calibration.usual({"gravity.enabled": False, "payload.enabled": True})


def test_machines_at_random_are_others_and_keep_away_from_singularities(library: Library) -> None:
    """Machines differ by key; equal keys give equal machines."""
    benches = [trials.any_bench(np.random.Generator(np.random.Philox(key=key)), library) for key in (1, 2, 1)]
    assert benches[0] == benches[2] != benches[1] and all(trials.away(bench) for bench in benches)


@pytest.mark.nightly
def test_a_machine_at_random_is_calibrated(library: Library) -> None:
    row = trials.one(library, 3, "any")
    assert all(row["identified"]) and np.abs(np.divide(row["off"], row["sigma"])).max() < 4


def test_trials_resume(tmp_path: Path) -> None:
    """Trials of this unit are not repeated; a file of another unit is refused."""
    file = tmp_path / "trials.jsonl"
    assert trials.done(file, "a") == {}
    file.write_text(
        '{"key": 100, "unit": "a", "off": [1.0]}\n{"key": 101, "unit": "b", "off": [1.0]}\n', encoding="utf-8"
    )
    assert list(trials.done(file, "a")) == [100]
    assert trials.inside([{"off": [1.9, -2.0], "sigma": [1.0, 1.0]}]).tolist() == [[1.0, 0.0]]
    unknown = trials.inside([{"off": [1.9, -2.0], "sigma": [1.0, 1.0], "identified": [True, False]}])
    assert unknown[0, 0] == 1.0 and math.isnan(unknown[0, 1])
    file.write_text("{}", encoding="utf-8")
    with pytest.raises(TwinError, match="delete it to start again"):
        trials.done(file, "a")
