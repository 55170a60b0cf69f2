"""Learned values reach the user: panel of the dashboard, learned.json, a unit of one's own, a calibration, the next run."""

import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import PATIENCE
from fivebar import scene as scenes_of
from fivebar.commands import main
from fivebar.errors import FiveBarError
from fivebar.instance import Unit
from fivebar.library import Library
from fivebar.own_unit import write_unit
from fivebar.scene_file import OFFSETS
from fivebar.twin import dashboard, figures, learned_scene, record, scene
from fivebar.twin.config import Config
from fivebar.twin.follower import LEARNED
from fivebar.twin.messages import TRACKED, Message
from fivebar.twin.soak import configured, machine
from fivebar.twin.watch import CAUSES
from fivebar.variables import of_unit
from twin_support import follower, recorded

QUANTILE = 5.991
"""95 % quantile of chi squared with two degrees of freedom."""

TRUE_DISCS = {"estimator.sigma0.eccentricity": 0.0}
"""Settings of a twin whose encoders have centred discs: a second of a fall then determines lengths and encoder offsets."""

MASSES = tuple(f"link[{i}].mass" for i in (1, 2, 3, 4))
LENGTHS = (*(f"link[{i}].length" for i in (1, 2, 3, 4)), "base.distance")


def test_what_was_learned_makes_a_unit_a_calibration_and_the_next_run(
    tmp_path: Path, fmu: Path, library: Library
) -> None:
    """Springs throw the machine about. After three seconds masses that were off by 3 to 5 % are known to 0.5 %, a payload off by a fifth to 1 %."""
    config = configured(tmp_path / "first", fmu, library, "spring_payload", learn=True, exact=True)
    run, truth = recorded(config, library, 600), config.machine.hidden
    learned = figures.read(run.folder).learned
    assert learned is not None
    file = tmp_path / "learned.json"
    learned_scene.write(file, config.path / scene.SOURCE, learned["values"])

    before, after = scenes_of.read("spring_payload", library.known), scenes_of.read(file, library.known)
    assert after.signals.keys() == before.signals.keys() and after.stop_time == before.stop_time
    for name in MASSES:
        off, learned_off = (abs(each[name] / truth[name] - 1) for each in (before, after))
        assert off > 0.025 and learned_off < 0.005, (name, off, learned_off)
        inertia = name.replace("mass", "inertia")
        # Inertia is learned with the mass.
        assert after[inertia] / before[inertia] == pytest.approx(after[name] / before[name], rel=1e-12)
    assert abs(after["payload.mass"] / truth["payload.mass"] - 1) < 0.01
    # The scene has no friction, the machine has the unit's default. It is learned to 12 % (rms); the joints at the motors are worst.
    assert after["viscous.enabled"] is True and not before["viscous.enabled"]
    off = [abs(after[f"viscous.b[{i}]"] / 1e-4 - 1) for i in range(1, 6)]
    assert math.hypot(*off) < 0.2 * math.sqrt(5) and max(off) < 0.35, off

    own = write_unit(tmp_path, after, plain=fmu).file
    assert own.name == "Learned.fmu" and of_unit(own)["link[1].mass"].start == learned["values"]["link[1].mass"]

    common = [
        "--fmu",
        str(fmu),
        "--scene",
        str(file),
        "--parameters",
        "payload.mass",
        "--seconds",
        "1",
        "--out",
        str(tmp_path / "calibrate"),
    ]
    assert main(["calibrate", str(run.folder), *common]) == 0
    found = json.loads((tmp_path / "calibrate" / "calibration.json").read_text())
    assert found["begins_from"] == f"scene {file}" and found["unknowns"]["payload.mass"]["scene"] == {
        "payload.mass": after["payload.mass"]
    }

    # Half a second of free motion: the learned machine is nineteen times closer than the scene; ten times is required.
    tips = []
    unit = Unit.of(library)
    for values in (before.values | truth, before.values, after.values):
        unit.reset(**values)
        for k in range(1, 51):
            unit.step_to(0.01 * k)
        tips.append(unit.get(*TRACKED))
    unit.close()
    assert math.dist(tips[2], tips[0]) < 0.1 * math.dist(tips[1], tips[0]), tips


def followed(config: Config, library: Library, samples: int) -> tuple[float, float, float]:
    """Follows `samples` samples. Of the last half: median error of the tip, m, median half-width of its band, m, and the share inside."""
    twin, source, errors = follower(config, library), machine(config, library), []
    for k in range(samples):
        sample = source.next()
        twin.meas(sample)
        estimated = twin.estimate().fields
        if k >= samples // 2:
            # An estimate is one macro step ahead of its sample.
            off = np.array(
                [
                    estimated[name] - twin.setup.step * estimated[name.replace("tip.", "tip.v")] - sample.fields[name]
                    for name in TRACKED
                ]
            )
            xx, xy, yy = (estimated[f"estimated.tip.cov[{i}]"] for i in (1, 2, 3))
            covariance = np.array([[xx, xy], [xy, yy]])
            errors.append(
                (
                    np.linalg.norm(off),
                    np.sqrt(QUANTILE * np.linalg.eigvalsh(covariance)[1]),
                    off @ np.linalg.solve(covariance, off) < QUANTILE,
                )
            )
    twin.close()
    source.close()
    error, width, inside = np.array(errors).T
    return float(np.median(error)), float(np.median(width)), float(np.mean(inside))


def learned_in(config: Config, library: Library, samples: int) -> Message:
    """Values and standard deviations that a twin has learned after `samples` samples of its machine."""
    twin, source = follower(config, library), machine(config, library)
    for _ in range(samples):
        twin.meas(source.next())
    learned = twin.learned()
    twin.close()
    source.close()
    assert learned is not None
    return learned


@pytest.mark.parametrize("exact", [True, False])
def test_a_fall_does_not_determine_a_common_factor_of_masses(
    tmp_path: Path, fmu: Path, library: Library, exact: bool
) -> None:
    """The common factor keeps value and uncertainty (5 %, divided by the root of four masses) while unknown friction is learned.

    If friction did not scale with the factor, the filter would claim 0.5 to 1.4 %, and be off by 14 % with inexact geometry.
    """
    config = configured(tmp_path, fmu, library, "fall_90_120", learn=True, exact=exact)
    config = replace(config, twin=config.twin | ({} if exact else TRUE_DISCS))
    learned = learned_in(config, library, 600)
    values, truth = learned.extra["values"], config.machine.hidden
    factors = [values[name] / truth[name] for name in MASSES]
    before = math.prod(float(library.variable(name).start) / truth[name] for name in MASSES) ** 0.25
    for i, name in enumerate(MASSES, 1):
        # Ratios of masses are learned to 0.1 %, negligible beside 2.5 %.
        assert learned.fields[f"estimated.mass.sigma[{i}]"] / values[name] == pytest.approx(0.025, rel=0.02), name
    # Round-off and nonlinearity; a standard deviation is 2.5 %.
    assert math.prod(factors) ** 0.25 == pytest.approx(before, abs=0.0025)
    assert max(factors) / min(factors) < 1.005
    assert all(abs(values[f"viscous.b[{i}]"] / 1e-4 - 1) < 0.1 for i in range(1, 6))


def test_lengths_and_encoder_offsets_are_written_together(tmp_path: Path, fmu: Path, library: Library) -> None:
    """Lengths off by 0.1 % and encoders off by 1 and 2 mrad are learned in falls, written, and used to follow the machine again.

    Errors of the tip: 0.22 mm with the scene's values, 0.009 mm with all learned values, 0.28 mm with learned lengths but no offsets, 0.010 mm
    with learned lengths and offsets and the machine's own masses and friction. Bands, 1.7 to 1.8 mm in all runs, follow from the scene's priors.
    """
    folder = tmp_path / "first"
    config = configured(folder, fmu, library, "fall_90_120", learn=True)
    config = replace(config, twin=config.twin | TRUE_DISCS)
    truth = config.machine.hidden | dict(zip(OFFSETS, (1e-3, -2e-3), strict=True))
    config = replace(config, machine=replace(config.machine, hidden=truth))
    values = learned_in(config, library, 1000).extra["values"]
    for name in OFFSETS:
        assert abs(values[name] - truth[name]) < 2e-5, (name, values[name])
    # A fortieth of the initial error.
    for name in LENGTHS:
        assert abs(values[name] - truth[name]) < 5e-6, (name, values[name])

    found = {}
    geometry = truth | {name: values[name] for name in (*LENGTHS, *OFFSETS)}
    lengths = {name: value for name, value in values.items() if name not in OFFSETS}
    for name, handed in (("scene", {}), ("all", values), ("geometry", geometry), ("lengths", lengths)):
        file = tmp_path / f"{name}.json"
        learned_scene.write(file, config.path / scene.SOURCE, handed)
        again = configured(tmp_path / name, fmu, library, file)
        found[name] = followed(replace(again, machine=config.machine), library, 1000)
    assert found["geometry"][0] < found["scene"][0] / 10 and found["geometry"][0] < found["lengths"][0] / 10, found
    error, width, inside = found["all"]
    assert error < found["scene"][0] / 10 and error < found["lengths"][0] / 10, found
    assert inside > 0.95 and error < width and 0.5 < width / found["scene"][1] < 2, found

    # If learning continues, newly learned offsets add to the written ones.
    again = configured(tmp_path / "on", fmu, library, tmp_path / "all.json", learn=True)
    again = replace(again, twin=again.twin | TRUE_DISCS)
    more = learned_in(replace(again, machine=config.machine), library, 600).extra["values"]
    assert all(abs(more[name] - truth[name]) < 2e-5 for name in OFFSETS)

    made = write_unit(tmp_path, scenes_of.read(tmp_path / "all.json", library.known), plain=fmu)
    assert made.notes[-1].startswith(
        "The machine's encoders have offsets, which the master must subtract from readings and commands: "
    )
    assert all(f"{values[name]:.6g} rad for measured.theta{name[-3:]}" in made.notes[-1] for name in OFFSETS)


def test_a_calibration_starts_from_encoder_offsets_and_writes_them(tmp_path: Path, fmu: Path, library: Library) -> None:
    """Offsets may be unknowns or not; the written scene has them. Residuals are the encoder's steps, 0.03 mrad, instead of 1 mrad."""
    offsets = dict(zip(OFFSETS, (1e-3, -1.5e-3), strict=True))
    config = configured(tmp_path, fmu, library, "fall_90_120", exact=True)
    run = recorded(replace(config, machine=replace(config.machine, hidden=offsets)), library, 240)
    content = json.loads((config.path / scene.SOURCE).read_text()) | offsets
    (tmp_path / "with_offsets.json").write_text(json.dumps(content))
    common = [
        "calibrate",
        str(run.folder),
        "--fmu",
        str(fmu),
        "--scene",
        str(tmp_path / "with_offsets.json"),
        "--out",
        str(tmp_path),
        "--no-proposal",
    ]
    for sought in ("link[1].mass", OFFSETS[0]):
        assert main([*common, "--parameters", sought]) == 0
        found = json.loads((tmp_path / "calibration.json").read_text())
        assert max(found["residuals_rad"]["encoder"]) < 1e-4, found["residuals_rad"]
        content = json.loads((tmp_path / "calibrated.json").read_text())
        assert all(content[name] == pytest.approx(offset, abs=5e-5) for name, offset in offsets.items())
    assert found["unknowns"][OFFSETS[0]]["scene"] == {OFFSETS[0]: 1e-3}


def test_drives_get_the_same_commands(tmp_path: Path, fmu: Path, library: Library) -> None:
    """Servos use encoder angles: commands stay as planned, and forecasts of a machine that keeps its commands have a plan."""
    first = configured(tmp_path / "first", fmu, library, "pick_and_place", exact=True)
    learned_scene.write(
        tmp_path / "learned.json", first.path / scene.SOURCE, dict(zip(OFFSETS, (1e-3, -2e-3), strict=True))
    )
    again = configured(tmp_path / "again", fmu, library, tmp_path / "learned.json", exact=True)
    before, after = (machine(replace(config, machine=first.machine), library) for config in (first, again))
    twin = follower(again, library)
    for _ in range(150):
        sample, other = before.next(), after.next()
        assert sample.fields == pytest.approx(other.fields, abs=1e-9)
        twin.meas(sample)
        assert twin.book is not None and twin.book.on_plan
    estimated = twin.estimate().fields
    # Estimates are true angles, without offsets.
    assert (
        estimated["theta[1]"] == pytest.approx(sample.fields["measured.theta[1]"] - 1e-3, abs=2e-3)
        and estimated["estimated.tau.sigma[1]"] > 0
    )
    for each in (before, after, twin):
        each.close()


def test_a_value_at_its_bound_is_reported(tmp_path: Path, fmu: Path, library: Library) -> None:
    """An encoder offset of ten standard deviations gives one warning of the unit and one alarm for the dashboard."""
    config = configured(tmp_path, fmu, library, "fall_90_120", learn=True)
    hidden = config.machine.hidden | {OFFSETS[0]: 2e-2}
    run = recorded(replace(config, machine=replace(config.machine, hidden=hidden)), library, 600)
    alarms = record.messages(run.folder, "alarm", refused=lambda _: None)
    sentences = [message.extra["sentence"] for message in alarms if message.extra["state"] == "trouble"]
    assert (
        sum(
            "estimated.offset[1] = 0.008 rad has been moved to its bound (allowed: -0.008 to 0.008 rad)" in each
            for each in sentences
        )
        == 1
    ), sentences
    assert len(sentences) == len(set(sentences)) and all("has been moved to its bound" in each for each in sentences)


def test_encoder_offsets_of_a_scene_are_checked(tmp_path: Path, library: Library) -> None:
    """A turn, a text, or a name that is not an encoder is refused."""
    for entry, sentence in (
        ({OFFSETS[0]: 4}, "'encoder.offset[1]' must be an angle of -pi to pi in rad, not 4"),
        ({OFFSETS[1]: "1 mrad"}, "'encoder.offset[2]' must be an angle of -pi to pi in rad"),
        (
            {"encoder.offset[3]": 0.1},
            "there is no variable 'encoder.offset[3]'; did you mean 'encoder.offset[2]' or 'encoder.offset[1]'?",
        ),
    ):
        (tmp_path / "a.json").write_text(json.dumps({"description": "a"} | entry))
        with pytest.raises(FiveBarError, match=re.escape(sentence)):
            scenes_of.read(tmp_path / "a.json", library.known)


def test_a_variable_with_a_signal_keeps_it(tmp_path: Path, library: Library) -> None:
    """A payload that the scene changes with time is not written as a start value, and no sentence comes twice."""
    source, learned = scenes_of.found("pick_up"), tmp_path / "learned.json"
    signalled = json.loads(source.read_text())["signals"]
    assert "payload.mass" in signalled
    for given in (source, learned):
        learned_scene.write(learned, given, {"payload.mass": 0.02, "link[1].mass": 0.018})
    content = json.loads(learned.read_text())
    assert content["link[1].mass"] == 0.018 and "payload.mass" not in content and content["signals"] == signalled
    assert content["description"].count(learned_scene.LEARNED) == 1
    scenes_of.read(learned, library.known)


def test_learning_is_off_by_default(tmp_path: Path, fmu: Path, library: Library, scenes: Path) -> None:
    """Scene or switch turn it on; standard deviations of the scene are kept."""
    config = configured(tmp_path / "off", fmu, library, "pick_and_place")
    assert dashboard.about(config)["learned"] == []
    own = json.loads((scenes / "pick_and_place.json").read_text())
    (tmp_path / "own.json").write_text(
        json.dumps(own | {"estimator.learn.enabled": True, "estimator.learn.payload": 0.003})
    )
    shown = dashboard.about(configured(tmp_path / "scene", fmu, library, tmp_path / "own.json"))["learned"]
    assert {each["name"]: each["width"] for each in shown}["estimated.payload"] == 0.003 and not any(
        "viscous" in each["name"] for each in shown
    )
    (tmp_path / "own.json").write_text(json.dumps(own | {"estimator.learn.viscous": 2e-5}))
    shown = dashboard.about(configured(tmp_path / "switch", fmu, library, tmp_path / "own.json", learn=True))["learned"]
    assert [each["name"] for each in shown] == [name for name in LEARNED if name != "estimated.friction"]
    for each in shown:
        assert (
            each["unit"] in ("kg", "N.m.s/rad", "m", "rad")
            and each["label"]
            and each["width"] > 0
            and each["sigma"] in library.variables
        )
    last = next(each for each in shown if each["name"] == "estimated.viscous[5]")
    assert last["start"] == 0.0 and last["width"] == 2e-5


def test_page_and_watch_have_the_same_words_for_causes(tmp_path: Path, fmu: Path, library: Library) -> None:
    """Page and alarm show the same cause: both use the names of the watch."""
    assert tuple(dashboard.about(configured(tmp_path, fmu, library, "pick_and_place"))["causes"]) == CAUSES
    script = (Path(dashboard.__file__).with_name("page") / "dashboard.js").read_text(encoding="utf-8")
    assert "causeOf(f, about.causes)" in script and "force at the tip" not in script
    # Numbers as in the unit: a torque at each motor, a force, each encoder, parameters, timing.
    description = library.variable("estimated.cause").description
    assert (
        "1 and 2 a torque" in description
        and "3 a force at the tip, 4 and 5 the left and the right encoder, 6 parameters, 7 timing" in description
    )


def test_the_page_counts_what_the_server_counts() -> None:
    """If the page counted other messages too, the server would send more than the page can draw."""
    script = (Path(dashboard.__file__).with_name("page") / "dashboard.js").read_text(encoding="utf-8")
    found = re.search(r"^const SKIPPED = (\[.*?\]);", script, re.MULTILINE)
    assert found and tuple(json.loads(found[1])) == dashboard.SKIPPED


@pytest.mark.nightly
def test_the_command_learns_and_writes_a_scene(tmp_path: Path, fmu: Path) -> None:
    """Processes, broker and summary; a run without learning removes the learned scene of an earlier run."""

    def text(*more: str) -> str:
        command = [
            sys.executable,
            "-m",
            "fivebar",
            "twin",
            "--seconds",
            "3",
            "--fmu",
            str(fmu),
            "--out",
            str(tmp_path),
            *more,
        ]
        run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE)
        assert run.returncode == 0, run.stdout + run.stderr
        return run.stdout

    assert f"in {tmp_path / 'learned.json'}" in text("--learn", "--exact")
    learned = json.loads((tmp_path / "summary.json").read_text())["learned"]
    content = json.loads((tmp_path / "learned.json").read_text())
    assert learned["values"].items() <= content.items() and content["payload.mass"] != 0.05
    assert abs(content["payload.mass"] / 0.06 - 1) < 0.05
    text()
    assert not (tmp_path / "learned.json").exists()
