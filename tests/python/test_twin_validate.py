"""`fivebar validate`: predictions of the held-out part against simple predictors, coverage of bands, promises, exit codes."""

import html
import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import REPOSITORY
from fivebar import table
from fivebar.commands import main
from fivebar.errors import MachineWarning
from fivebar.library import Library
from fivebar.plain import plain
from fivebar.twin import figures, held_out, scene, setup, starter, torque_scale, validate
from fivebar.twin.errors import TwinError
from fivebar.twin.held_out import HeldOut
from fivebar.twin.soak import configured, machine
from twin_support import follower, recorded

Columns = dict[str, np.ndarray]

Judge = Callable[..., tuple[int, dict]]
"""Validates a record against a scene, with further words of the command; exit code and content of `validation.json`."""


@pytest.fixture(scope="module")
def swing(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Columns:
    """4.5 s of the stand-in: masses off by up to 5 %, lengths by 0.1 %, encoders by 1 mrad; the twin's model has no friction."""
    library = Library(fmu)
    source = machine(configured(tmp_path_factory.mktemp("machine"), fmu, library, "swing"), library)
    samples = [source.next() for _ in range(900)]
    source.close()
    library.close()
    columns = {name: np.array([sample.fields[name] for sample in samples]) for name in samples[0].fields}
    return {"time": 1e-9 * np.array([sample.time - samples[0].time for sample in samples])} | columns


@pytest.fixture
def plain_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Validations have empty pictures: drawing takes a third of their time."""
    for name in ("_errors", "_coverage"):
        monkeypatch.setattr(validate, name, lambda _: validate.plt.figure(figsize=(1, 1)))


@pytest.fixture
def judge(fmu: Path, tmp_path: Path) -> Judge:
    def run(columns: Columns, given: object, *more: str) -> tuple[int, dict]:
        table.write_columns(tmp_path / "record.csv", columns)
        if isinstance(given, dict):
            (tmp_path / "scene.json").write_text(json.dumps(given), encoding="utf-8")
            given = tmp_path / "scene.json"
        words = ["validate", str(tmp_path / "record.csv"), "--scene", str(given), "--fmu", str(fmu)]
        code = main([*words, "--out", str(tmp_path / "out"), *more])
        return code, json.loads((tmp_path / "out" / "validation.json").read_text(encoding="utf-8"))

    return run


def test_the_scene_s_own_machine_is_predicted(
    swing: Columns, judge: Judge, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, content = judge(swing, "swing")
    part = content["held_out"]
    assert code == 0 and content["missed"] == [] and content["alarms"] == 0
    assert (part["series"], part["samples"], content["samples"]["estimated"]) == (1, 300, 900)
    # Without servos there are no commands to compare with.
    assert part["command_delay_s"] is None and part["not_judged"] == [
        "the last command as a predictor: the record has no servo.theta[1] and servo.theta[2]",
        "the drives: the record has no commands, so that all drive torques are unknown forces for the twin",
    ]
    assert list(part["forecasts"]) == ["0.1", "0.5"] and part["innovations"]["coverage95"] > 0.9
    for given in part["forecasts"].values():
        assert given["coverage95"] > 0.9 and list(given["others"]) == ["hold", "constant velocity"]
        for i in range(2):
            assert 5 * given["rms_mrad"][i] < min(other["rms_mrad"][i] for other in given["others"].values())
    # The start value of estimator.torqueScale is right.
    assert content["unknown_torque"]["size99_nm"] < content["unknown_torque"]["torque_scale_nm"] / torque_scale.FACTOR
    assert content["unknown_torque"]["advice"] == ""
    printed = capsys.readouterr().out
    assert "unknown torque: " in printed and "copy into" not in printed
    assert "innovations" in printed and "constant velocity" in printed and "promise" not in printed
    written = {file.name for file in (tmp_path / "out").iterdir()}
    assert written == {"validation.json", "index.html", "errors.png", "coverage.png"}
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 2 and "<h1>swing: the twin judged by a recording</h1>" in page and "{{" not in page


@pytest.mark.usefixtures("plain_pictures")
def test_the_tip_shows_lengths_off_by_a_tenth(
    swing: Columns, judge: Judge, scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Motor angles alone hardly show wrong lengths: estimated forces compensate for them."""
    longer = json.loads((scenes / "swing.json").read_text(encoding="utf-8"))
    longer |= {f"link[{i}].length": 0.231 for i in (1, 2, 3, 4)}
    code, content = judge(swing, longer)
    assert code == 1 and len(content["missed"]) == 1
    assert "of the tips are inside the 95 % circles 0.5 s ahead; 90 % are promised" in content["missed"][0]
    assert f"promise not kept: {content['missed'][0]}" in capsys.readouterr().out
    blind = {name: column for name, column in swing.items() if not name.startswith("tip")}
    code, content = judge(blind, longer)
    assert code == 0 and content["tip_forecasts"] is None and content["tip_error_mm"]["rms"] is None
    assert content["held_out"]["not_judged"][0] == "the tip, and with it the lengths: the record has no tip.x and tip.y"


@pytest.mark.usefixtures("plain_pictures")
def test_series_are_judged_one_by_one(swing: Columns, judge: Judge) -> None:
    """The last third of each series is judged; the twin restarts with the second one."""
    columns = {name: np.concatenate([column[:420], column[480:]]) for name, column in swing.items()}
    columns["time"][420:] -= columns["time"][420]
    code, content = judge(columns, "swing")
    assert code == 0 and content["held_out"]["series"] == 2 and content["held_out"]["samples"] == 280
    assert content["held_out"]["seconds"] == pytest.approx(2 * 419 * 0.005 / 3, rel=1e-5)


@pytest.mark.usefixtures("plain_pictures")
def test_a_short_record_names_what_is_not_judged(swing: Columns, judge: Judge) -> None:
    code, content = judge({name: column[:240] for name, column in swing.items()}, "swing")
    assert code == 0
    assert (
        "forecasts 0.5 s ahead: 0 end in the held-out part; 20 or more are needed" in content["held_out"]["not_judged"]
    )


@pytest.mark.usefixtures("plain_pictures")
def test_later_commands_may_be_known(
    fmu: Path, judge: Judge, scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Forecasts along recorded torques are those along the same torques in the scene, and others than with the last torques held."""
    given = json.loads((scenes / "swing.json").read_text(encoding="utf-8"))
    knots = [[0.1 * k, 0.01 * math.sin(k)] for k in range(46)]
    moved = given | {
        "experiment": {"stopTime": 4.5, "stepSize": 0.001},
        "signals": {"tau[1]": {"linear": knots}, "tau[2]": {"linear": [[t, -tau] for t, tau in knots]}},
    }
    (tmp_path / "moved.json").write_text(json.dumps(moved), encoding="utf-8")
    library = Library(fmu)
    source = machine(configured(tmp_path / "machine", fmu, library, tmp_path / "moved.json", exact=True), library)
    samples = [source.next() for _ in range(900)]
    source.close()
    library.close()
    columns = {name: np.array([sample.fields[name] for sample in samples]) for name in samples[0].fields}
    columns["time"] = 1e-9 * np.array([sample.time - samples[0].time for sample in samples])
    (_, held), (_, planned), (_, known) = (
        judge(columns, given),
        judge(columns, moved),
        judge(columns, given, "--known-commands"),
    )
    assert capsys.readouterr().out.count("; forecasts know the later commands") == 1
    held, planned, known = (each["held_out"] for each in (held, planned, known))
    assert (held["known_commands"], planned["known_commands"], known["known_commands"]) == (False, False, True)
    for ahead in ("0.1", "0.5"):
        without, by_plan, by_record = (each["forecasts"][ahead]["rms_mrad"] for each in (held, planned, known))
        # The record rounds commands to nine digits.
        assert by_record == pytest.approx(by_plan, rel=1e-3)
        assert without != pytest.approx(by_plan, rel=0.05), (without, by_plan, by_record)
    del columns["tau[1]"], columns["tau[2]"]
    table.write_columns(tmp_path / "record.csv", columns)
    words = ["validate", str(tmp_path / "record.csv"), "--scene", "swing", "--fmu", str(fmu), "--known-commands"]
    assert main([*words, "--out", str(tmp_path / "none")]) == 2 and not (tmp_path / "none").exists()
    assert (
        "has no commands for the forecasts to use; it needs a column servo.theta, servo.omega or tau"
        in capsys.readouterr().err
    )


def test_a_record_that_cannot_be_followed_is_refused(
    swing: Columns, fmu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A record without an encoder, and encoders that are never sampled together."""
    file, (left, right) = tmp_path / "record.csv", ("measured.theta[1]", "measured.theta[2]")
    is_even = np.arange(len(swing["time"])) % 2 == 0
    apart = {left: np.where(is_even, swing[left], np.nan), right: np.where(is_even, np.nan, swing[right])}
    for columns, sentence in (
        (
            {name: column for name, column in swing.items() if name != right},
            f"has no number in {right}; both encoders are needed",
        ),
        (swing | apart, f"has no sample with both {left} and {right}: no twin can start"),
    ):
        table.write_columns(file, columns)
        assert main(["validate", str(file), "--scene", "swing", "--fmu", str(fmu), "--out", str(tmp_path / "out")]) == 2
        assert sentence in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_servos_that_are_on_without_commands_are_warned_of_first(
    swing: Columns, fmu: Path, scenes: Path, tmp_path: Path
) -> None:
    """The warning comes with the first sample, before the record is played."""
    torques = {f"tau[{i}]": np.full(len(swing["time"]), 0.01 * i) for i in (1, 2)}
    table.write_columns(
        tmp_path / "record.csv",
        {name: column for name, column in swing.items() if not name.startswith("servo")} | torques,
    )
    given = json.loads((scenes / "swing.json").read_text(encoding="utf-8"))
    gains = {"servo.enabled": True, "servo.kp[1]": 1.5, "servo.kp[2]": 1.5}
    (tmp_path / "scene.json").write_text(json.dumps(given | gains), encoding="utf-8")
    options = validate.Options(tmp_path / "record.csv", tmp_path / "scene.json", fmu, tmp_path / "out")
    config = starter.configure(validate._of_recording(options), tmp_path)
    with pytest.warns(
        MachineWarning, match=r"the scene's servos are on, but the record has tau\[1\] and tau\[2\] and no"
    ):
        starter.check_followed(config, True)


def test_the_encoders_of_a_scene_are_those_of_machine_and_twin(fmu: Path, scenes: Path, tmp_path: Path) -> None:
    """If the scene names its encoders, the stand-in's default of 16 bits does not replace them."""
    coarse = 0.01
    content = json.loads((scenes / "swing.json").read_text(encoding="utf-8")) | {"estimator.quantum[2]": coarse}
    (tmp_path / "coarse.json").write_text(json.dumps(content), encoding="utf-8")
    library = Library(fmu)
    config = configured(tmp_path / "run", fmu, library, tmp_path / "coarse.json")
    values = setup.of_run(config, scene.read(Path(config.scene)), library.guid).values
    assert (values["estimator.quantum[1]"], values["estimator.quantum[2]"]) == (config.machine.quantum, coarse)
    source = machine(config, library)
    steps = [source.next().fields["measured.theta[2]"] / coarse for _ in range(50)]
    assert steps == pytest.approx(np.round(steps)) and len(set(np.round(steps))) > 1
    source.close()
    library.close()


# --- figures of made records ---------------------------------------------------------------------------------------------------------

PERIOD, SIGMA, OFF = 0.005, 1e-3, 0.2


def made(angle: Callable[[np.ndarray], np.ndarray], commands: bool = False) -> figures.Story:
    """A record of 12 s whose forecasts have errors as large as their bands say; commands lead the angles by `OFF` s."""
    chance, story = np.random.default_rng(1), figures.Story()
    time = PERIOD * np.arange(2400)
    for t in time.tolist():
        sample = {"measured.theta[1]": float(angle(t)), "measured.theta[2]": float(-angle(t))}
        commanded = {"servo.theta[1]": float(angle(t + OFF)), "servo.theta[2]": float(-angle(t + OFF)) - 2 * math.pi}
        story.measured.add({"time": t} | sample | (commanded if commands else {}))
        errors = chance.normal(size=2)
        fields = {"theta[1]": float(angle(t)) + 2 * math.pi, "theta[2]": float(-angle(t))}
        fields |= {f"estimated.innovation[{i}]": SIGMA * errors[i - 1] for i in (1, 2)}
        story.estimated.add({"time": t + 1e-3, "sample": t, "estimated.nis": float(errors @ errors)} | fields)
        for k in range(1, 11):
            at = t + 1e-3 + 0.05 * k
            row = {"time": t + 1e-3, "ahead": 0.05 * k, "last": float(k == 10)}
            off = SIGMA * chance.normal(size=2)
            row |= {"theta[1]": float(angle(at)) + 2 * math.pi + off[0], "theta[2]": float(-angle(at)) + off[1]}
            story.forecasts.add(row | {f"estimated.theta.sigma[{i}]": SIGMA for i in (1, 2)})
    return story


def judged(story: figures.Story, tmp_path: Path, fmu: Path) -> HeldOut:
    library = Library(fmu)
    config = configured(tmp_path / "run", fmu, library, "swing")
    library.close()
    return held_out.judge(config, story)


def test_bands_are_judged_by_counting(tmp_path: Path, fmu: Path) -> None:
    """800 innovations and some 1,400 forecast angles: the standard deviation of a share of 95 % is 0.8 and 0.6 %."""
    found = judged(made(lambda t: 0.3 * t), tmp_path, fmu)
    assert found.samples == 800 and found.seconds == pytest.approx(2399 * PERIOD / 3)
    for errors in (found.innovations, *(each.errors for each in found.forecasts)):
        assert errors.coverage() == pytest.approx(0.95, abs=0.024) and errors.coverage(0.5) == pytest.approx(
            0.5, abs=0.055
        )
        assert errors.relative_width() == pytest.approx(1.0, abs=0.06)
    for each in found.forecasts:
        assert np.sqrt(np.nanmean(each.errors.error**2)) == pytest.approx(SIGMA, rel=0.06)
    assert found.missed() == [] or all("rms" in sentence for sentence in found.missed())


def test_other_predictors_match_their_definitions(tmp_path: Path, fmu: Path) -> None:
    """On a ramp of 0.3 rad/s, through whole turns, `constant velocity` is exact and `hold` lags; a ramp determines no delay."""
    found = judged(made(lambda t: 0.3 * t), tmp_path, fmu)
    for each in found.forecasts:
        known = np.isfinite(each.errors.error[:, 0])
        assert np.abs(each.others["constant velocity"][known]).max() < 1e-9
        assert np.abs(each.others["hold"][known, 0] + 0.3 * (each.ahead + 1e-3)).max() < 1e-9
    assert [each.ahead for each in found.forecasts] == pytest.approx([0.1, 0.5]) and found.delay is None
    (sentence, other) = found.missed()
    assert (
        "forecasts of encoder 1 0.1 s ahead are" in sentence
        and "`constant velocity`" in sentence
        and "2 0.1 s" in other
    )


def test_an_encoder_at_rest_is_not_judged(tmp_path: Path, fmu: Path) -> None:
    """At rest all errors are 0, which shows nothing about the twin."""
    resting, moving = (
        judged(made(angle), tmp_path, fmu).not_judged for angle in (lambda t: 0.0 * t, lambda t: 0.3 * t)
    )
    said = [f"motion of encoder {i}: it rests in the held-out part, which every predictor knows" for i in (1, 2)]
    assert resting[-2:] == said and not set(said) & set(moving)


def test_the_last_command_knows_what_forecasts_know(tmp_path: Path, fmu: Path) -> None:
    library = Library(fmu)
    config = configured(tmp_path / "run", fmu, library, "swing")
    library.close()
    found = held_out.judge(config, made(lambda t: np.sin(3 * t), commands=True), known_commands=True)
    assert all(np.nanmax(np.abs(each.others["last command"])) < 9 * PERIOD**2 / 8 + 1e-6 for each in found.forecasts)


def test_the_delay_of_commands_is_found_and_used(tmp_path: Path, fmu: Path) -> None:
    """Commands lead by 0.2 s: they predict the angle 0.1 s ahead, up to linear interpolation, but not 0.5 s ahead."""
    found = judged(made(lambda t: np.sin(3 * t), commands=True), tmp_path, fmu)
    assert found.delay == pytest.approx(OFF, abs=1e-9)
    near, far = (np.nanmax(np.abs(each.others["last command"])) for each in found.forecasts)
    assert near < 9 * PERIOD**2 / 8 + 1e-6 and far > 0.5


def test_readings_may_jump_by_whole_turns(tmp_path: Path, fmu: Path) -> None:
    """An absolute encoder, which shows 0 to 2π, gives the same figures as a counting one."""
    counting = made(lambda t: 1.5 * t)
    wrapped = made(lambda t: 1.5 * t)
    for name in ("measured.theta[1]", "measured.theta[2]"):
        column = wrapped.measured.columns[name]
        column[:] = type(column)("d", np.mod(column, 2 * math.pi).tolist())
    first, second = (judged(story, tmp_path, fmu) for story in (counting, wrapped))
    for one, other in zip(first.forecasts, second.forecasts, strict=True):
        assert other.errors.error == pytest.approx(one.errors.error, abs=1e-9, nan_ok=True)
        assert other.others["hold"] == pytest.approx(one.others["hold"], abs=1e-9, nan_ok=True)


# --- recordings of real machines -----------------------------------------------------------------------------------------------------


@pytest.fixture
def recordings() -> Path:
    """The folder FIVEBAR_RECORDINGS: others own these recordings, so the repository does not contain them."""
    folder = os.environ.get("FIVEBAR_RECORDINGS")
    if not folder:
        pytest.skip("FIVEBAR_RECORDINGS names no folder of recordings of real machines")
    return Path(folder)


def documented(holds: str) -> str:
    """The block of JSON in docs/recordings.md that contains a text."""
    page = (REPOSITORY / "docs" / "recordings.md").read_text(encoding="utf-8")
    [found] = [block for block in re.findall(r"```json\n(.*?)```", page, re.DOTALL) if holds in block]
    return found


def test_a_haptic_pantograph(recordings: Path, fmu: Path, tmp_path: Path) -> None:
    """From the bag to the figures by the map and the scene of docs/recordings.md, which have ten lines. A hand and unrecorded drives move the
    machine, and masses and friction are guesses."""
    files = {"map.json": documented("joint1"), "pantograph.json": documented('"description"')}
    assert sum(text.count("\n") for text in files.values()) <= 10
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    record = str(tmp_path / "record.csv")
    assert (
        main(["import", str(recordings / "haptic_pantograph"), "--map", str(tmp_path / "map.json"), "-o", record]) == 0
    )
    words = ["validate", record, "--scene", str(tmp_path / "pantograph.json"), "--fmu", str(fmu)]
    code = main([*words, "--out", str(tmp_path / "out")])
    content = json.loads((tmp_path / "out" / "validation.json").read_text(encoding="utf-8"))
    part = content["held_out"]
    # The one goal that may be missed: 1.2 times the error of the best other predictor. Measured: 1.21 and 1.13.
    assert all(text.startswith("forecasts of encoder 1 0.1 s ahead") for text in content["missed"])
    assert code == int(bool(content["missed"]))
    assert content["samples"]["followed"] == content["samples"]["estimated"] == 6055
    # A drive holds axis 1 for 3.6 s, which is no frozen encoder.
    assert len(part["not_judged"]) == 3 and content["alarms"] == 0 and content["unknown_torque"]["advice"] == ""
    # A tenth and a quarter more than measured, for digits of other builds. Measured: a width of 12.1.
    near = part["forecasts"]["0.1"]
    best = np.min([other["rms_mrad"] for other in near["others"].values()], axis=0)
    assert np.all(np.array(near["rms_mrad"]) <= 1.33 * best) and near["relative_width95"] <= 15
    assert all(each["coverage95"] >= 0.99 for each in (part["innovations"], *part["forecasts"].values()))


def test_a_serial_arm(recordings: Path, fmu: Path, tmp_path: Path) -> None:
    """Four runs by both motors, with the authors' parameters and known commands: the goals of docs/recordings.md for this arm are met."""
    command = [sys.executable, str(REPOSITORY / "examples" / "serial_arm.py")]
    subprocess.run([*command, str(recordings / "dfki_double_pendulum"), str(tmp_path)], check=True)
    words = ["validate", str(tmp_path / "record.csv"), "--scene", str(tmp_path / "scene.json"), "--fmu", str(fmu)]
    # Exit code 0: at least 90 % of innovations and forecasts are inside. Measured: 93.6 %, 94.7 % (0.1 s) and 100 % (0.5 s).
    assert main([*words, "--out", str(tmp_path / "out"), "--known-commands"]) == 0
    content = json.loads((tmp_path / "out" / "validation.json").read_text(encoding="utf-8"))
    part = content["held_out"]
    # All samples of the four files; the estimate leaves none of them.
    assert part["series"] == 4 and content["samples"]["followed"] == 19987
    # No false alarm: nothing pushes the arm. Its torque scale of 0.1 N.m stays, although play makes unknown torques of 1.6 N.m.
    assert content["alarms"] == 0 and content["unknown_torque"]["advice"] == ""
    for ahead, share in (("0.1", 0.5), ("0.5", 1.0)):
        forecasts = part["forecasts"][ahead]
        best = np.min([other["rms_mrad"] for other in forecasts["others"].values()], axis=0)
        # Goal: half the rms error of the best baseline at 0.1 s (measured: 0.17 and 0.28), below it at 0.5 s (0.32 and 0.26).
        assert np.all(np.array(forecasts["rms_mrad"]) <= share * best)
        # Goal: bands at most 4 times too wide. Measured: 1.0 and 1.9 times.
        assert forecasts["relative_width95"] <= 4
    near = part["forecasts"]["0.1"]
    velocity = near["others"]["constant velocity"]["median_mrad"]
    # Impacts of the joints' play dominate the rms, but not the median. Measured: 7.11 of 58.4 mrad and 9.82 of 81.6 mrad, an eighth.
    # Without the elbow's rotor the error is twice as large, a quarter.
    assert all(6 * own < other for own, other in zip(near["median_mrad"], velocity, strict=True))


# --- the scale of unknown torques ----------------------------------------------------------------------------------------------------

GRIPPER = REPOSITORY / "tests" / "data" / "gripper"


@pytest.fixture(scope="module")
def gripped(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Columns:
    """12 s of the gripper at 100 Hz: the gain of its drives is 1 N·m/rad, and commands act 17 ms late."""
    library = Library(fmu)
    config = configured(tmp_path_factory.mktemp("gripper"), fmu, library, GRIPPER / "scene.json")
    hidden = json.loads((GRIPPER / "machine.json").read_text(encoding="utf-8"))
    source = machine(replace(config, period=0.01, machine=replace(config.machine, hidden=hidden)), library)
    samples = [source.next() for _ in range(1200)]
    source.close()
    library.close()
    columns = {name: np.array([sample.fields[name] for sample in samples]) for name in samples[0].fields}
    return {"time": 1e-9 * np.array([sample.time - samples[0].time for sample in samples])} | columns


def test_a_stand_in_with_late_commands_starts_at_rest(gripped: Columns) -> None:
    """Until the first commands act, the drives hold them. All commands rest for 0.3 s, and so does the machine, to the last step of an encoder."""
    for i in (1, 2):
        assert np.ptp(gripped[f"servo.theta[{i}]"][:30]) == np.ptp(gripped[f"measured.theta[{i}]"][:30]) == 0


@pytest.mark.parametrize("kp", [1.5, pytest.param(0.5, marks=pytest.mark.nightly)])
def test_a_torque_scale_is_proposed_that_ends_false_alarms(
    gripped: Columns, judge: Judge, kp: float, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """With the weight of the links as the scale, the alarm is on for more than half of the time. The proposed scale is right the first time."""
    believed = json.loads((GRIPPER / "scene.json").read_text(encoding="utf-8"))
    del believed["estimator.torqueScale"], believed["signals"]
    believed |= {f"servo.kp[{i}]": kp for i in (1, 2)}
    _, content = judge(gripped, believed)
    found = content["unknown_torque"]
    assert found["torque_scale_nm"] == pytest.approx(9.81 * (0.02 * 0.03 + 0.015 * 0.06), rel=1e-5)
    assert found["alarm_share"] > 0.5 and found["tried"]["torque_scale_nm"] == found["proposed"]
    assert found["proposed"] == pytest.approx(torque_scale.FACTOR * found["size99_nm"], rel=0.05)
    line = f'"estimator.torqueScale": {found["proposed"]:g}'
    printed, page = capsys.readouterr().out, (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert line in found["advice"] and found["advice"] in printed
    assert f"{html.escape(found['advice'])}</p>" in page
    if kp == 1.5:
        assert found["advice"] in (REPOSITORY / "docs" / "validation.md").read_text(encoding="utf-8")
    _, content = judge(gripped, believed | json.loads(f"{{{line}}}"))
    again = content["unknown_torque"]
    assert content["alarms"] == 0 and content["held_out"]["innovations"]["coverage95"] >= 0.9
    assert (again["tried"], again["proposed"], again["advice"]) == (None, None, "")
    assert again["alarm_share"] <= torque_scale.QUIET
    # The size is measured with the scale, yet two measurements are alike.
    assert 0.5 < again["size99_nm"] / found["size99_nm"] <= 1.05
    assert "copy into the scene" not in capsys.readouterr().out


def test_the_gripper_s_twin_is_quiet(fmu: Path, tmp_path: Path) -> None:
    """A minute with the scale in the scene, without forecasts: at most one alarm, although gain and delay of the drives are wrong."""
    library = Library(fmu)
    config = configured(tmp_path / "run", fmu, library, GRIPPER / "scene.json")
    hidden = json.loads((GRIPPER / "machine.json").read_text(encoding="utf-8"))
    run = recorded(replace(config, period=0.01, machine=replace(config.machine, hidden=hidden)), library, 6100)
    library.close()
    assert run.watch.alarms <= 1 and run.twin.counts["estimated"] == 6100


@pytest.mark.parametrize("given", ["pick_and_place", REPOSITORY / "tests" / "data" / "own_machine.json"])
def test_the_start_value_of_the_scale_is_the_weight_of_the_links(given: str | Path, fmu: Path, tmp_path: Path) -> None:
    """A unit with this scale estimates the same torques as with 0, also with a payload. The scale's last digit may differ: 1e-6 of a torque
    is far more than it moves in a second, and far less than a scale 1 % off."""
    library = Library(fmu)
    config = configured(tmp_path / "run", fmu, library, given)
    weight = torque_scale.effective(library, scene.read(Path(config.scene)).values)
    source = machine(config, library)
    samples = [source.next() for _ in range(200)]
    source.close()

    def torques(scale: float) -> np.ndarray:
        twin = follower(replace(config, twin={torque_scale.NAME: scale}), library)
        found = []
        for sample in samples:
            assert twin.meas(sample)
            found.append(list(twin.unit.floats(("estimated.tau[1]", "estimated.tau[2]")).values()))
        twin.close()
        return np.array(found)

    by_default = torques(0.0)
    size = float(np.abs(by_default).max())
    assert size > 0 and np.abs(torques(weight) - by_default).max() < 1e-6 * size
    assert np.abs(torques(1.01 * weight) - by_default).max() > 1e-4 * size
    library.close()


def followed(torque: np.ndarray, status: np.ndarray, alarm: np.ndarray) -> figures.Story:
    """A record of estimates with torques of the left motor, N·m, every 10 ms."""
    story = figures.Story()
    for k, (size, state, on) in enumerate(zip(torque.tolist(), status.tolist(), alarm.tolist(), strict=True)):
        row = {"estimated.tau[1]": size, "estimated.tau[2]": -size / 2, "estimated.status": state}
        story.estimated.add({"time": 0.01 * k, "estimated.alarm": on} | row)
    return story


def test_the_size_is_measured_while_the_twin_follows() -> None:
    """Starts, rejected samples, singularities (both torques 0) and short pushes do not count."""
    count = 4000
    torque, status, alarm = np.linspace(0.1, 0.2, count), np.full(count, torque_scale.FOLLOWING), np.zeros(count)
    plain = torque_scale.measure(followed(torque, status, alarm), 1.0, 0.95)
    assert plain.size == pytest.approx(0.199, abs=1e-3) and plain.fits and plain.to_try() is None
    torque[:200] = 9.0
    torque[1000:1010] = 9.0
    status[2000:2400], torque[2000:2400] = 8.0, 9.0
    torque[3000:3100] = 0.0
    assert torque_scale.measure(followed(torque, status, alarm), 1.0, 0.95).size == pytest.approx(0.199, abs=2e-3)
    # Alarms count while samples are rejected, too; those of the first 2 s do not.
    alarm[2000:2380], alarm[:200] = 1.0, 1.0
    assert torque_scale.measure(followed(torque, status, alarm), 1.0, 0.95).alarms == pytest.approx(0.1, abs=1e-3)
    few = torque_scale.measure(followed(torque[:250], status[:250], alarm[:250]), 1e-3, 0.5)
    assert few.size is None and not few.fits and few.to_try() is None
    # Nothing is known about alarms of a record that ends within 2 s.
    short = torque_scale.measure(followed(torque[:150], status[:150], alarm[:150]), 1.0, 0.95)
    assert math.isnan(short.alarms) and short.fits and short.content()["alarm_share"] is None


def test_a_scale_is_proposed_if_it_is_needed_and_helps() -> None:
    def needed(scale: float, alarms: float, inside: float = 0.95, size: float | None = 0.1) -> torque_scale.Needed:
        return torque_scale.Needed(scale, size, alarms, inside)

    # Alarms or innovations outside, and a scale that is too small.
    assert needed(0.01, 0.1).to_try() == needed(0.01, 0.0, 0.89).to_try() == 0.5
    assert needed(0.01, 0.0).to_try() is None and needed(0.25, 0.1).to_try() is None
    now = needed(0.01, 0.1)
    assert torque_scale.Advice(now, needed(0.5, 0.0)).proposed == 0.5
    assert torque_scale.Advice(needed(0.01, 0.1, math.nan), needed(0.5, 0.0)).proposed is None
    # Pushes, or a wrong model: the other scale does not help. The last two runs follow nothing.
    for tried in (
        None,
        needed(0.5, 0.1),
        needed(0.5, 0.0, 0.89),
        needed(0.5, 0.0, 0.95, None),
        needed(0.5, 0.0, math.nan),
    ):
        advice = torque_scale.Advice(now, tried)
        assert advice.proposed is None and advice.sentence() == "" and advice.content()["proposed"] is None


def test_an_alarm_from_the_start_on_is_printed() -> None:
    """Such an alarm has no begin, so that it is not counted; its share of the time is printed beside the number."""
    content = {"alarms": 0, "causes": [], "unknown_torque": {"alarm_share": 1.0, "size99_nm": 1.0}}
    assert validate._alarms(content) == "alarms: 0; on 100 % of the time (without the first 2 s of each series)"
    part = {"samples": 1, "innovations": {"coverage95": None}, "forecasts": {}}
    assert "<b>100<small> %</small></b><span>of the time with an alarm" in validate._cards(content | {"held_out": part})
    content |= {"alarms": 2, "causes": ["force", "fault"]}
    content["unknown_torque"] |= {"alarm_share": 0.0123}
    assert (
        validate._alarms(content)
        == "alarms: 2, of force, fault; on 1.23 % of the time (without the first 2 s of each series)"
    )
    content |= {"alarms": 0, "causes": [], "unknown_torque": {"alarm_share": None, "size99_nm": None}}
    assert validate._alarms(content) == "alarms: 0; not judged: no series is longer than 2 s"
    assert "<b>–<small> %</small></b><span>of the time with an alarm" in validate._cards(content | {"held_out": part})


def test_small_numbers_are_short() -> None:
    """Errors of an exact record are round-off; its table has a space between any two cells."""
    numbers = [3.45e-11, 1.02e-15, -9e-10, 1.5e-6, 0.000123456, 1234.5, -0.00123456, math.nan]
    assert [plain(number) for number in numbers] == ["0", "0", "0", "0.000002", "0.000123", "1230", "-0.00123", "nan"]
    errors = {"median_mrad": [1.2345e-4, 123456789.0], "rms_mrad": [3.45e-8, 1234567890.0]}
    content = {"samples": 1, "seconds": 1.0, "series": 1, "command_delay_s": None, "known_commands": False}
    content |= {"innovations": errors | {"coverage95": 1.0, "relative_width95": 1.0}, "forecasts": {}, "not_judged": []}
    cells = held_out.lines(content)[-1].split()
    assert cells == ["innovations", "0.000123", "0", "123000000", "1230000000", "100", "1"]


def test_shares_are_plain_numbers() -> None:
    def needed(alarms: float) -> torque_scale.Needed:
        return torque_scale.Needed(0.01, 0.1, alarms, 0.95)

    assert (
        "(alarms 0 % of the time in place of 100 %, 95 % of"
        in torque_scale.Advice(needed(1.0), replace(needed(0.0), scale=0.5)).sentence()
    )
    numbers = [
        plain(value, digits) for value, digits in ((1234.5, 3), (99.7, 2), (1e-5, 2), (0.30000001, 3), (math.nan, 3))
    ]
    assert numbers == ["1230", "100", "0.00001", "0.3", "nan"]


def test_results_remain_if_the_second_run_fails(
    fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> None:
        raise TwinError("the unit failed")

    now = torque_scale.Needed(0.01, 0.1, 0.1, 0.95)
    monkeypatch.setattr(validate, "_needed", lambda *_: now)
    monkeypatch.setattr(validate, "Player", lambda _: None)
    monkeypatch.setattr(validate, "_play", fail)
    library = Library(fmu)
    config = configured(tmp_path / "run", fmu, library, "swing")
    story = made(lambda t: 0.3 * t)
    assert validate._advice(config, library, story, held_out.judge(config, story)) == torque_scale.Advice(now)
    library.close()
    assert capsys.readouterr().out == "the second run, with estimator.torqueScale = 0.5, failed: the unit failed\n"
