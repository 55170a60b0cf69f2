"""`fivebar run` on a short scene: files, summary, exit code."""

import csv
import json
import logging
import math
import os
import pickle
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import fivebar
from conftest import REPOSITORY
from fivebar import scene as scene_of
from fivebar import summary
from fivebar.commands import main
from fivebar.drive import Run
from fivebar.errors import FiveBarError
from fivebar.kinematics import Machine
from fivebar.scene import Scene, Variant, parse
from fivebar.variables import Values
from made_scene import METHODS, made_scene, write

PUSH: Values = {"tau[1]": 0.25, "solver.method": METHODS["i3alp"]}
FINE = Variant("RK4, fine", PUSH | {"solver.method": METHODS["rk4"], "solver.stepSize": 2e-4})
SHORT = made_scene(PUSH, 0.2, 0.002, FINE, description="A short trial </script> of everything.")
HOPELESS: Values = {"tau[1]": 50.0, "solver.adaptive": False, "solver.maxIterations": 1}
UNREACHABLE: Values = {"init.theta[1]": math.pi, "init.theta[2]": 0.0}


def run(fmu: Path, folder: Path, scene: Scene, *options: str) -> subprocess.CompletedProcess[str]:
    """Runs a scene; everything is written to `folder`/out."""
    file = write(folder / "short.json", scene)
    command = [
        sys.executable,
        "-m",
        "fivebar",
        "run",
        str(file),
        "--fmu",
        str(fmu),
        "--out",
        str(folder / "out"),
        *options,
    ]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


Done = tuple[Path, subprocess.CompletedProcess[str]]
"""Files and output of a run."""


@pytest.fixture(scope="module")
def done(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Done:
    """The short scene, run once."""
    folder = tmp_path_factory.mktemp("run")
    return folder / "out", run(fmu, folder, SHORT)


def test_summary(done: Done) -> None:
    _, process = done
    assert process.returncode == 0, process.stderr
    for fact in (
        "tip at the end", "largest energy error", "mgL", "constraint violation", "smallest singular value", "singularities met",
        "seen at communication points, every 2 ms", "0 combined, 0 constraint", "below 1 mm up to t = 0.2 s, largest",
        "200 steps", "sub-steps", "iterations", "rejected", "wall time", "fmi2DoStep", "real-time factor", "against i3alp",
        "Written:",
    ):  # fmt: skip
        assert fact in process.stdout, fact
    # Not a terminal: a line every 10 % and no control characters.
    assert process.stderr.count("short (i3alp)") == 10 and "\x1b" not in process.stderr
    # Then a line for each file, in the order of the list.
    named = re.findall(r"^short: writing (.+)$", process.stderr, re.MULTILINE)
    assert named == re.findall(r"^  out/(\S+)  \(", process.stdout, re.MULTILINE) and "tip.png" in named


def test_files(done: Done) -> None:
    out, process = done
    pictures = {"tip", "path", "energy", "constraints", "singularity", "substeps", "difference"}
    expected = {f"{p}.png" for p in pictures} | {
        "path.svg",
        "animation.svg",
        "short.csv",
        "short.rk4-fine.csv",
        "singularities.csv",
        "short.html",
    }
    assert {file.name for file in out.iterdir()} == expected
    assert all(str(Path("out") / name) in process.stdout for name in expected)


def test_pictures_match_the_effects_of_a_scene(fmu: Path, tmp_path: Path) -> None:
    """Servos, stops, a plane and a changing load have pictures; the signals are in the table."""
    effects: Values = {f"{effect}.enabled": True for effect in ("servo", "stop", "contact")}
    theta, omega = np.linspace(1.5708, 1.5, 101), np.full(101, -0.708)
    signals = {"tip.fx": np.linspace(0, 0.2, 101), "servo.theta[1]": theta, "servo.omega[1]": omega}
    process = run(fmu, tmp_path, replace(made_scene(effects | {"servo.theta[2]": 2.0}, 0.1), signals=signals))
    assert process.returncode == 0, process.stderr
    assert {f"{name}.png" for name in ("servo", "stop", "contact", "inputs")} <= {
        file.name for file in (tmp_path / "out").iterdir()
    }
    header = (tmp_path / "out" / "short.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert all(column in header for column in ("tip.fx", "servo.theta[1]", "servo.omega[1]"))
    page = (tmp_path / "out" / "short.html").read_text(encoding="utf-8")
    data = json.loads(page.split('<script type="application/json" id="data">')[1].split("</script>")[0])
    assert data["runs"][0]["plane"] == {"normal": [0, 1], "offset": -1}
    assert data["runs"][0]["stops"] == [[0, np.pi], [0, np.pi]]


def columns_of(file: Path) -> list[str]:
    with file.open(encoding="utf-8") as table:
        return next(csv.reader(table))


def test_chosen_outputs_are_the_columns(fmu: Path, tmp_path: Path) -> None:
    """Chosen by names and prefixes, with commas or one by one, inputs included; pictures, page and singularities do not change."""
    effects: Values = {"servo.enabled": True}
    scene = replace(
        made_scene(effects, 0.1, 1e-3, Variant("fine", effects)), signals={"tip.fx": np.linspace(0, 0.2, 101)}
    )
    every = run(fmu, tmp_path, scene)
    assert every.returncode == 0, every.stderr
    files = {file.name: file.read_bytes() for file in (tmp_path / "out").iterdir()}
    few = run(fmu, tmp_path, scene, "--outputs", "energy.error,tip", "--outputs", "theta")
    assert few.returncode == 0, few.stderr
    head = [
        "time",
        "tip.x",
        "tip.y",
        "tip.vx",
        "tip.vy",
        "theta[1]",
        "theta[2]",
        "tip.ax",
        "tip.ay",
        "energy.error",
        "tip.fx",
    ]
    for table in ("short.csv", "short.fine.csv"):
        assert columns_of(tmp_path / "out" / table) == head
        whole = files.pop(table).decode().splitlines()
        places = [whole[0].split(",").index(name) for name in head]
        assert (tmp_path / "out" / table).read_text(encoding="utf-8").splitlines() == [
            ",".join(row.split(",")[place] for place in places) for row in whole
        ]
    assert {name: (tmp_path / "out" / name).read_bytes() for name in files} == files
    assert {"inputs.png", "servo.png", "difference.png", "short.html"} <= set(files)


def test_the_columns_are_listed(fmu: Path, tmp_path: Path) -> None:
    """Unless columns were chosen, a line lists prefixes for `--outputs`, and the inputs."""
    scene = replace(made_scene({}, 0.01), signals={"tau[2]": np.zeros(11), "tau[1]": np.ones(11)})
    every = run(fmu, tmp_path, scene, "--no-pictures")
    [listed] = [line for line in every.stdout.splitlines() if line.startswith("Columns: ")]
    found = re.fullmatch(r"Columns: time, (.+); inputs: (.+); --outputs NAMES writes some of them", listed)
    assert found, listed
    counts = dict(re.fullmatch(r"(\w+) \((\d+)\)", part).groups() for part in found[1].split(", "))  # type: ignore[union-attr]
    columns = columns_of(tmp_path / "out" / "short.csv")
    assert found[2] == "tau[2], tau[1]" and columns[-2:] == ["tau[2]", "tau[1]"]
    for group, count in counts.items():
        assert sum(re.match(rf"{group}[.[]|{group}$", name) is not None for name in columns[:-2]) == int(count)
    assert 1 + sum(map(int, counts.values())) + 2 == len(columns)
    assert "Columns" not in run(fmu, tmp_path, scene, "--no-pictures", "--outputs", ",".join(counts)).stdout
    assert columns_of(tmp_path / "out" / "short.csv") == columns[:-2]


@pytest.mark.parametrize(
    ("outputs", "sentence"),
    [
        ("tip.z", "there is no column 'tip.z'; did you mean 'tip.y' or 'tip.x' or 'tip'?"),
        ("tip,enrgy", "there is no column 'enrgy'; did you mean 'energy'?"),
        ("tau", "there is no column 'tau'; known are time, tip, theta, omega, "),
        ("tip,", "there is no column ''; known are time, tip, theta, omega, "),
    ],
)
def test_outputs_that_there_are_not_are_refused(fmu: Path, tmp_path: Path, outputs: str, sentence: str) -> None:
    process = run(fmu, tmp_path, SHORT, "--outputs", outputs)
    assert process.returncode == 2 and process.stderr.startswith(f"fivebar run: {sentence}")
    assert process.stderr.count("\n") == 1 and not (tmp_path / "out").exists()


def test_without_pictures(fmu: Path, tmp_path: Path, done: Done) -> None:
    """Only tables and page are written; pictures of an earlier run are removed, and the drawing packages are not loaded."""
    shutil.copytree(done[0], tmp_path / "out")
    assert run(fmu, tmp_path, SHORT, "--no-pictures").returncode == 0
    left = {"short.csv", "short.rk4-fine.csv", "singularities.csv", "short.html"}
    assert {file.name for file in (tmp_path / "out").iterdir()} == left
    code = "import sys; from fivebar.commands import main; main(sys.argv[1:]); print('matplotlib' in sys.modules)"
    command = [sys.executable, "-c", code, "run", "short.json", "--fmu", str(fmu), "--no-pictures"]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert process.stdout.endswith("\nFalse\n") and "short/short.html" in process.stdout


def test_an_earlier_run_leaves_nothing(fmu: Path, tmp_path: Path, done: Done) -> None:
    """A run removes files of an earlier run of the scene and no others; inside the current directory, printed paths are relative."""
    out = shutil.copytree(done[0], tmp_path / "out")
    own = {file.name for file in out.iterdir()}
    foreign = {"notes.csv", "shorter.csv", "my.png", "short.txt", "short.notes.csv"}
    for name in foreign:
        (out / name).write_text("mine")
    again = run(fmu, tmp_path, made_scene(PUSH | {"gravity.enabled": False}, 0.1))
    assert again.returncode == 0, again.stderr
    left = {file.name for file in out.iterdir()}
    assert left == own - {"short.rk4-fine.csv", "difference.png"} | foreign
    assert "mgL (g = 9.81 m/s2)" in again.stdout
    assert f"  {Path('out') / 'short.csv'}  (" in again.stdout and str(tmp_path) not in again.stdout


@pytest.mark.parametrize("name", ["path.svg", "tip.png", "short.csv", "short.rk4-fine.csv", "short.html"])
def test_files_of_others_are_neither_replaced_nor_removed(
    fmu: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """A recording may have the name of its scene. The run is refused before it begins."""
    scene = write(tmp_path / "short.json", SHORT)
    mine = tmp_path / "out" / name
    mine.parent.mkdir()
    mine.write_text("mine")
    result = fivebar.run(scene, stop_time=0.01, outputs="tip")
    sentence = f"{mine} is no file of an earlier run, and this run would replace it; another folder is needed"
    if name in ("short.csv", "short.html"):
        with pytest.raises(FiveBarError, match=f"^{re.escape(sentence)}$"):
            result.save(mine.parent, draw=False)
    else:
        # Without pictures and overlays, such a name is free, also beside the page of an earlier run.
        assert len(result.save(mine.parent, draw=False)) == len(result.save(mine.parent, draw=False)) == 3
    assert main(["run", str(scene), "--fmu", str(fmu), "--out", str(mine.parent)]) == 2
    assert capsys.readouterr().err == f"fivebar run: {sentence}\n" and mine.read_text() == "mine"


def test_a_page_of_ones_own_is_replaced_without_its_list(fmu: Path, tmp_path: Path) -> None:
    """Ctrl-C leaves a page without its list, or half a page; `animate` keeps the list."""
    result = fivebar.run(write(tmp_path / "short.json", SHORT), stop_time=0.01, outputs="tip")
    (tmp_path / "out").mkdir()
    page = result.animate(tmp_path / "out" / "short.html")
    page.write_bytes(page.read_bytes()[:5000])
    files = result.save(page.parent, draw=False)
    result.animate(page)
    assert result.save(page.parent, draw=False) == files and page.read_text("utf-8").count("fivebar wrote") == 2


def test_runs_that_diverge() -> None:
    """The summary gives the time until which two tips stay within 1 mm, even if they meet again later."""
    time = np.arange(6) * 0.5

    def made_up(x: list[float]) -> Run:
        return Run("made up", 2.5, 0.5, {}, {"time": time, "tip.x": np.array(x), "tip.y": 0 * time}, {})

    still = made_up([0.0] * 6)
    words = {
        "below 1 mm up to t = 1 s, largest 2.00e-01 m at t = 2 s": [0, 0, 9e-4, 0.1, 0.2, 0],
        "below 1 mm up to t = 2.5 s, largest 9.00e-04 m at t = 1 s": [0, 0, 9e-4, 0, 0, 0],
        "1 mm or more from the start, largest 1.00e-01 m at t = 0 s": [0.1, 0, 0, 0, 0, 0],
    }
    for expected, x in words.items():
        assert summary.difference(still, made_up(x)).endswith(f"distance of the tips {expected}")


def test_csv(done: Done) -> None:
    out, _ = done
    with (out / "short.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    header = rows[0]
    assert header[0] == "time" and {
        "tip.x",
        "energy.error",
        "singular.detJq",
        "solver.steps",
    } <= set(header)
    table = np.array(rows[1:], dtype=float)
    assert table.shape == (101, len(header)) and np.isfinite(table).all()
    assert table[-1, 0] == 0.2 and table[-1, header.index("solver.steps")] == 200


def test_pictures(done: Done) -> None:
    out, _ = done
    for path in out.glob("*.png"):
        assert path.stat().st_size < 400_000
        with Image.open(path) as picture:
            assert min(picture.size) > 300 and sum(n > 0 for n in picture.convert("L").histogram()) > 20, (
                f"{path.name} is blank"
            )
            inked = np.asarray(picture.convert("L")) < 250
            for lines in (inked.any(axis=0), inked.any(axis=1)):
                # Margins are 5 to 12 dots; truncated text would reach the edge.
                edges = lines.argmax(), lines[::-1].argmax()
                assert min(edges) >= 2 and max(edges) < 30, f"{path.name} is cut off or has an empty edge"


def test_page(done: Done) -> None:
    out, _ = done
    page = (out / "short.html").read_text(encoding="utf-8")
    assert "http://" not in page and "https://" not in page
    assert "{{" not in page
    # The description cannot end the script element that holds the data.
    data = page.split('<script type="application/json" id="data">')[1].split("</script>")[0]
    assert json.loads(data)["description"] == SHORT.description
    assert len(json.loads(data)["runs"]) == 2


def test_a_run_that_fails_writes_its_part(fmu: Path, tmp_path: Path) -> None:
    """The printed method without sub-steps fails under a violent torque: exit code 1 and the FMU's sentence."""
    process = run(fmu, tmp_path, made_scene(HOPELESS, 0.2), "--no-pictures")
    assert process.returncode == 1
    assert "ended early" in process.stdout and "0.2 s" in process.stdout
    assert (tmp_path / "out" / "short.csv").is_file() and (tmp_path / "out" / "short.html").is_file()


def test_an_overlay_that_fails_is_part_of_the_summary(fmu: Path, tmp_path: Path) -> None:
    overlays = [Variant("hopeless", HOPELESS), Variant("unreachable", UNREACHABLE)]
    process = run(fmu, tmp_path, made_scene({}, 0.2, 1e-3, *overlays), "--no-pictures")
    assert process.returncode == 0, process.stderr
    assert "ended early" in process.stdout and "unreachable did not start" in process.stdout


def test_a_step_that_fails_raises_an_error_with_the_part_result(fmu: Path) -> None:
    """A partial result is never returned silently."""
    hopeless = made_scene(HOPELESS | {"solver.maxIterations": 3}, 0.2)
    with pytest.raises(fivebar.StepFailed) as failure:
        fivebar.run(hopeless)
    result = failure.value.result
    assert result is not None and 2 < len(result.time) < 200 and result.failure is not None
    assert str(failure.value) == (
        f"trial ended early, after t = {result.time[-1]:g} s of 0.2 s: {result.failure}"
    ) and isinstance(failure.value, FiveBarError)
    again = pickle.loads(pickle.dumps(failure.value))
    assert str(again) == str(failure.value) and again.result["tip.x"].tolist() == result["tip.x"].tolist()
    short = fivebar.run(hopeless, on_failure="return")
    assert short.failure == result.failure and short["tip.x"].tolist() == result["tip.x"].tolist()


def test_warnings_of_a_run_are_logged(fmu: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The logger of units gets the warnings; without logging, standard error stays empty."""
    with caplog.at_level(logging.WARNING, "fivebar"):
        result = fivebar.run("swing", stop_time=0.01, inputs={"servo.theta[1]": ([0, 0.01], [0, 1])})
    [record] = caplog.records
    assert (record.name, record.levelno, [record.getMessage()]) == (
        "fivebar.unit",
        logging.WARNING,
        result.own.warnings,
    )
    assert "servo.enabled is false" in record.getMessage() and record.getMessage() in result.summary()
    code = "import fivebar; fivebar.run('swing', stop_time=0.01, inputs={'servo.theta[1]': ([0, 0.01], [0, 1])})"
    environment = os.environ | {"FIVEBAR_FMU": str(fmu)}
    silent = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert silent.stderr == ""


def test_another_stop_time_and_step(fmu: Path) -> None:
    """Signals are sampled from their knots at the new communication points."""
    fine = fivebar.run("servo_step", stop_time=0.05, step_size=5e-4, outputs="tip")
    assert (len(fine.time), fine.time[-1]) == (101, 0.05)
    swing = scene_of.read("pick_and_place")
    finer = swing.replace(stop_time=0.7, step_size=5e-4)
    name = next(name for name in swing.signals if name.startswith("servo.theta"))
    course = finer.signals[name]
    assert course[::2].tolist() == pytest.approx(swing.signals[name][:701], abs=1e-12)
    # Half way between two points of the scene the value is interpolated, not constant.
    moving = 2 * np.flatnonzero(np.diff(course[::2]))
    assert len(moving) > 100 and np.all(course[moving + 1] != course[moving])
    assert swing.replace(stop_time=1.0).stop_time == 1.0 and swing.replace() == swing.replace({})


def test_stop_time_and_step_by_the_command(fmu: Path, tmp_path: Path) -> None:
    process = run(fmu, tmp_path, SHORT, "--no-pictures", "--stop-time", "0.05", "--step-size", "0.01")
    assert process.returncode == 0, process.stderr
    rows = (tmp_path / "out" / "short.csv").read_text(encoding="utf-8").splitlines()[1:]
    assert [row.partition(",")[0] for row in rows] == ["0.0", "0.01", "0.02", "0.03", "0.04", "0.05"]
    refused = run(fmu, tmp_path, SHORT, "--stop-time", "-1")
    assert refused.returncode == 2
    assert refused.stderr.startswith("fivebar run: Invalid value for '--stop-time': -1.0 is not in the range x>0; ")


def test_a_scene_that_names_no_method_runs_by_automatic(fmu: Path, tmp_path: Path) -> None:
    """Summary and label name it; a scene that names a method, or fixed steps of i3alp, keeps it."""
    plain = fivebar.run("swing", stop_time=0.01)
    assert plain.own.parameters["solver.method"] == METHODS["automatic"] and plain.own.label == "automatic"
    note = "  method                      automatic: it has no 'solver.method'\n"
    assert note in plain.summary() and note in run(fmu, tmp_path, made_scene({}, 0.01), "--no-pictures").stdout
    chosen: dict[str, dict[str, Any]] = {
        "dop853": {"method": "dop853"},
        "rk4": {"solver.method": "rk4"},
        "i3alp": {"solver.adaptive": False},
    }
    for name, given in chosen.items():
        other = fivebar.run("swing", stop_time=0.01, **given)
        assert other.own.parameters["solver.method"] == METHODS[name] and "automatic" not in other.summary()
    # If the scene of a result is run by another method, the scene names this method.
    assert "automatic" not in fivebar.run(plain.scene, method="rk4").summary()
    for name in ("paper_torque", "paper_torque_gravity", "paper_free_fall", "fall_90_120"):
        assert scene_of.read(name).values["solver.method"] == METHODS["i3alp"]
    assert fivebar.run(made_scene({}, 0.01), on_failure="return").own.label == "automatic"


def test_a_scene_as_a_dict(fmu: Path) -> None:
    """The content of a file, with numbers of NumPy; the description may be missing."""
    content = {"experiment": {"stopTime": 0.1}, "tau[1]": np.float64(0.01), "friction.enabled": np.True_}
    knots = np.array([[0, 0], [0.1, 0.02]])
    result = fivebar.run(content | {"signals": {"tau[2]": {"linear": knots}}}, **{"link[1].mass": np.float32(0.02)})
    assert result.scene.name == "scene" and result.time[-1] == 0.1 and result["tau[2]"][50] == pytest.approx(0.01)
    assert result.own.parameters["link[1].mass"] == np.float32(0.02) and result.own.parameters["friction.enabled"]


def test_refused(fmu: Path, tmp_path: Path) -> None:
    """A scene that cannot be started gives one sentence and exit code 2, without traceback or files."""
    process = run(fmu, tmp_path, made_scene(UNREACHABLE, 0.2))
    assert process.returncode == 2
    assert "0.84" in process.stderr and process.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_scene_by_another_method(fmu: Path, tmp_path: Path) -> None:
    """Every method works by name; an unknown name is refused with the list of methods."""
    scene = made_scene({"init.theta[2]": 2.0}, 0.2, 1e-3)
    by_name = run(fmu, tmp_path, scene, "--method", "i3alpConserving", "--no-pictures")
    assert by_name.returncode == 0, by_name.stderr
    assert "200 steps, 200 sub-steps" in by_name.stdout
    unknown = run(fmu, tmp_path, scene, "--method", "euler")
    assert unknown.returncode == 2 and unknown.stderr.count("\n") == 1
    assert "fivebar run: 'solver.method' must be one of i3alp, " in unknown.stderr and 'not "euler"' in unknown.stderr


def test_a_result_in_python_is_a_mapping_of_columns(fmu: Path) -> None:
    """Iteration and `in` use the names of the columns."""
    result = fivebar.run("swing")
    assert (
        list(result) == result.names
        and len(result) == len(result.names)
        and "tip.x" in result
        and "tip.z" not in result
    )


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (
            lambda: fivebar.run("swing", stopTime=1),
            "'stopTime' is not a variable: in Python use the arguments stop_time and step_size, s; in a scene's file stopTime and stepSize belong under 'experiment'",
        ),
        (
            lambda: fivebar.run(["swing"]),  # type: ignore[arg-type]
            "a scene is a name, a file that ends in .json, the content of one as a dict, or a fivebar.Scene, not [",
        ),
        (
            lambda: fivebar.run({"stopTime": 1}),
            "'stopTime' is not a variable: in Python use the arguments stop_time and step_size, s; in a scene's file stopTime and stepSize belong under 'experiment'",
        ),
        (lambda: fivebar.run({"tau": 0.1}), "'tau' has 2 elements, tau[1] to tau[2], but is given one"),
        (lambda: fivebar.run({"tauu": 0.1}), "there is no variable 'tauu'; did you mean 'tau[2]' or 'tau[1]'"),
        (lambda: fivebar.run({"tau[1]": {1}}), "a scene has numbers, texts, lists and dicts, not "),
        (lambda: fivebar.run("swing", stop_time=-1), "'stop_time' must be a positive number of seconds, not -1"),
        (lambda: fivebar.run("swing", step_size="1"), "'step_size' must be a positive number of seconds, not \"1\""),  # type: ignore[arg-type]
        (lambda: fivebar.run("swing", on_failure="stop"), "'on_failure' must be one of raise, return, not \"stop\""),  # type: ignore[arg-type]
        (lambda: Machine.from_scene("swing").inverse("abc"), "tip = 'abc': 2 numbers in m are expected"),
    ],
)
def test_what_python_is_given_wrongly_is_named(call: Callable[[], object], sentence: str) -> None:
    with pytest.raises(FiveBarError) as error:
        call()
    assert str(error.value).startswith(sentence)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("gravity.g", "'gravity.g' is a tunable parameter: if it is Real, it takes 'steps'"),
        ("link[1].mass", "'link[1].mass' is a fixed parameter"),
    ],
)
def test_a_parameter_with_a_signal_is_not_called_unknown(name: str, sentence: str) -> None:
    with pytest.raises(FiveBarError, match=re.escape(sentence)):
        parse("a", json.dumps({"description": "a", "signals": {name: {"linear": [[0, 1], [1, 2]]}}}))


@pytest.mark.parametrize(("end", "note"), [(0.6292, False), (3.7708, True)])
def test_references_that_cannot_be_closed_are_noted(end: float, note: bool) -> None:
    """A reference that would put the elbows 0.49 m apart gives a note."""
    page = (REPOSITORY / "docs" / "scenes.md").read_text(encoding="utf-8")
    (block,) = (
        text for text in re.findall(r"^```json\n(.*?)^```$", page, re.DOTALL | re.MULTILINE) if "servo.theta[1]" in text
    )
    content = json.loads(block)
    content["signals"]["servo.theta[1]"]["minimumJerk"][1][1] = end
    printed = fivebar.run(parse("turn", json.dumps(content))).summary()
    assert ("rad at t = 0.39 s cannot be reached: the elbows would be 0.4202 m apart" in printed) == note and (
        "  note" in printed
    ) == note
