"""The scripts of examples/, run as a user runs them: they succeed and print the promised results."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest

from conftest import REPOSITORY
from instance import Log, get_values, instantiate, set_values


def output(fmu: Path, folder: Path, name: str) -> str:
    """Output of examples/`name`, run outside the repository: the package finds its unit."""
    command = [sys.executable, str(REPOSITORY / "examples" / name)]
    environment = os.environ | {"FIVEBAR_FMU": str(fmu)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    # Warnings around a result would look like a part of it.
    assert "warning" not in (done.stdout + done.stderr).lower()
    return done.stdout


def test_switch_effects(fmu: Path, tmp_path: Path, model: object) -> None:
    """Every effect is shown, each ends elsewhere, the balances close, and the tuned spring acts one step after 0.5 s."""
    text = (REPOSITORY / "examples" / "switch_effects.py").read_text(encoding="utf-8")
    effects = [
        v.name for v in model.modelVariables if v.name.endswith(".enabled") and not v.name.startswith("estimator.")
    ]
    assert effects and all(f'"{effect}"' in text for effect in effects)
    printed = output(fmu, tmp_path, "switch_effects.py")
    rows = re.findall(r"^ *(\D.*?)  +(-?\d+\.\d{4}) +(-?\d+\.\d{4}) +(\d+\.\d{3}) +(\S+)$", printed, re.MULTILINE)
    assert len(rows) == 11 and len({row[1] for row in rows}) == 11
    # The energy of a fall is some 0.1 J; stiff stops and floors lose less than 1e-3 of it.
    assert all(abs(float(row[4])) < 1e-4 for row in rows)
    assert "the motion differs from t = 0.501 s on" in printed


def test_own_scene(fmu: Path, tmp_path: Path) -> None:
    """The push carries the tip to the right, and all energies are accounted for."""
    printed = output(fmu, tmp_path, "own_scene.py")
    start, furthest = (float(x) for x in re.findall(r"tip at x = (\S+) m", printed)[:2])
    assert furthest > start + 0.005
    assert float(re.findall(r"balance residual (\S+) J", printed)[0]) < 1e-6


def test_look_ahead(fmu: Path, tmp_path: Path) -> None:
    """The torque with the highest end is chosen, and looking ahead does not change the end of the twin's motion."""
    printed = output(fmu, tmp_path, "look_ahead.py")
    ways = [
        [(float(torque), float(y)) for torque, y in re.findall(r"(\S+) N\.m leads to (\S+) m", line)]
        for line in printed.splitlines()
    ]
    taken = [float(torque) for torque in re.findall(r"taken: (\S+) N\.m", printed)]
    assert len(taken) == 4
    assert taken == [max(way, key=lambda torque_and_height: torque_and_height[1])[0] for way in ways if way]
    directory = fmpy.extract(str(fmu), unzipdir=str(tmp_path / "unit"))
    slave = instantiate(model := fmpy.read_model_description(directory), directory, Log())
    set_values(slave, model, {"init.theta[2]": 2.0944, "viscous.enabled": True})
    slave.setupExperiment()
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for i, torque in enumerate(taken):
        set_values(slave, model, {"tau[1]": torque})
        slave.doStep(0.1 * i, 0.1)
    assert f"y = {get_values(slave, model, ['tip.y'])['tip.y']:+.4f} m" in printed.splitlines()[-1]
    slave.freeInstance()


def test_resynchronise(fmu: Path, tmp_path: Path) -> None:
    """The tip is known to some hundredths of a millimetre, within its bands; the unknown payload dominates errors 0.5 s ahead."""
    printed = output(fmu, tmp_path, "resynchronise.py")
    rows = re.findall(r"^ +(\d\.\d) +(\S+) +(\S+) +(\S+) +\d+$", printed, re.MULTILINE)
    assert len(rows) == 11, printed
    assert all(float(error) < min(0.05, 1.5 * float(band)) for _, error, band, _ in rows[1:]), printed
    ahead = [float(error) for *_, error in rows if error != "-"]
    assert len(ahead) == 6 and max(ahead) < 60, printed


def test_follow_push(fmu: Path, tmp_path: Path) -> None:
    """The push is noticed soon, the tip is known to some micrometres, and a picture is drawn."""
    printed = output(fmu, tmp_path, "follow_push.py")
    assert float(re.findall(r"tip error (\S+) mm", printed)[0]) < 0.03
    assert 0 <= float(re.findall(r"alarm (\S+) ms after the push", printed)[0]) <= 20
    assert (tmp_path / "target" / "follow_push.svg").is_file()


CELLS = """
import json, sys
if __name__ == "__main__":
    import matplotlib.pyplot
    matplotlib.use("Agg")
    names = {}
    for cell in json.load(open(sys.argv[1], encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
            if "picture" in cell["metadata"]:
                from notebook_picture import saving
                exec(saving(cell["metadata"]["picture"].rpartition("/")[2]), names)
            matplotlib.pyplot.close("all")  # as a notebook does after each cell
"""
"""Runs the code of a notebook; processes that it starts import this script."""


def test_readme_shows_the_picture_of_a_notebook() -> None:
    """The README shows one picture of a notebook, small enough for a page that many read."""
    files = [json.loads(path.read_text(encoding="utf-8")) for path in (REPOSITORY / "examples").glob("*.ipynb")]
    [picture] = [
        cell["metadata"]["picture"] for file in files for cell in file["cells"] if "picture" in cell["metadata"]
    ]
    assert f"]({picture})" in (REPOSITORY / "README.md").read_text(encoding="utf-8")
    assert (REPOSITORY / picture).stat().st_size < 100_000


@pytest.mark.parametrize(
    "name",
    ["my_machine", *(pytest.param(name, marks=pytest.mark.nightly) for name in ("follow", "free_fall"))],
)
def test_notebooks(fmu: Path, tmp_path: Path, name: str) -> None:
    """The cells run in order, use only public names, print the stored output and draw README's picture."""
    notebook = REPOSITORY / "examples" / f"{name}.ipynb"
    cells = [cell for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert not any("._" in "".join(cell["source"]) for cell in cells)
    printed = [
        "".join(output["text"]) for cell in cells for output in cell["outputs"] if output["output_type"] == "stream"
    ]
    (tmp_path / "cells.py").write_text(CELLS, encoding="utf-8")
    shutil.copy(REPOSITORY / "examples" / "fivebar.svg", tmp_path)
    command = [sys.executable, "cells.py", str(notebook)]
    environment = os.environ | {"FIVEBAR_FMU": str(fmu), "PYTHONPATH": str(REPOSITORY / "xtask" / "python" / "site")}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for picture in [REPOSITORY / cell["metadata"]["picture"] for cell in cells if "picture" in cell["metadata"]]:
        assert (tmp_path / picture.name).read_bytes() == picture.read_bytes(), "cargo xtask site --notebooks"
    assert printed and done.stdout == "".join(printed)
    # A page with more would be slow to open.
    assert notebook.stat().st_size < 300_000


def test_encoder_resolution(fmu: Path, tmp_path: Path) -> None:
    """Finer steps and more samples make the estimate better, and the page shows these figures."""
    printed = output(fmu, tmp_path, "encoder_resolution.py")
    assert printed in (REPOSITORY / "docs" / "questions.md").read_text(encoding="utf-8")
    rows = [[float(word) for word in line.split()] for line in printed.splitlines()[1:]]
    errors = np.array([row[2:5] for row in rows])
    assert errors.shape == (5, 3) and np.all(np.diff(errors, axis=0) < 0) and np.all(np.diff(errors, axis=1) < 0)


def test_accuracy_budget(fmu: Path, tmp_path: Path) -> None:
    """The squares of the sources add up, and the page shows these figures."""
    printed = output(fmu, tmp_path, "accuracy_budget.py")
    assert printed in (REPOSITORY / "docs" / "questions.md").read_text(encoding="utf-8")
    *sources, total = (float(line.split()[-1]) for line in printed.splitlines()[1:])
    # Each figure is rounded to half a micrometre.
    assert len(sources) == 6 and abs(sum(value**2 for value in sources) ** 0.5 - total) < 2e-3


def test_resume(fmu: Path, tmp_path: Path) -> None:
    assert output(fmu, tmp_path, "resume.py").endswith("the same bits\n")


def test_two_units(fmu: Path, tmp_path: Path) -> None:
    """At the end the wall holds the follower with five times the operator's 0.5 N, and the leader feels the wall."""
    last = [float(x) for x in output(fmu, tmp_path, "two_units.py").splitlines()[-1].split()]
    time, leader, follower, force, apart = last
    # 2.5 N indent a wall of 2e4 N/m by 0.125 mm.
    assert (
        time == 1.0
        and abs(force + 2.5) < 0.01
        and abs(follower - 0.26) < 5e-4
        and 0 < leader - follower < 1e-3
        and apart < 5
    )


@pytest.mark.parametrize("path", sorted((REPOSITORY / "examples").glob("*.py")), ids=lambda path: path.name)
def test_examples_are_short(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) < 90


def test_fixed_step(fmu: Path, tmp_path: Path) -> None:
    """Every macro step is one step of bounded work; energy and constraints are kept."""
    printed = output(fmu, tmp_path, "fixed_step.py")
    assert "10000 steps of 1.0 ms, 10000 sub-steps" in printed
    (energy,) = re.findall(r"largest energy error (\S+) J", printed)
    position, velocity = re.findall(r"at the end (\S+) m, (\S+) m/s", printed)[0]
    # 1e-8 mgL, as the battery requires for falls.
    assert float(energy) < 3.5e-10 and float(position) < 1e-14 and float(velocity) < 1e-11
    # The projection of the fallback adds some.
    assert int(re.findall(r"iterations of a step: (\d+)", printed)[0]) <= 70


@pytest.mark.full
def test_optimal_control(fmu: Path, tmp_path: Path) -> None:
    """The swing needs less torque than holding would; co-simulation reproduces the plan made by model exchange; a picture is drawn."""
    printed = output(fmu, tmp_path, "optimal_control.py")
    lifted, largest, holding = (
        float(x) for x in re.findall(r"lifted by (\S+) m; largest torque (\S+) N.m, to hold it (\S+) N.m", printed)[0]
    )
    assert lifted > 0.08 and largest <= 0.01 and holding > 6 * largest
    # Runge-Kutta's error over 1.2 s of 12.5 ms, and the unit's own.
    assert float(re.findall(r"the goal is missed by (\S+) deg", printed)[0]) < 0.01
    assert (tmp_path / "target" / "optimal_control.svg").stat().st_size > 10_000


def test_workspace(fmu: Path, tmp_path: Path) -> None:
    """Motor angles of the docs' example, a refusal with its figure, the robot's disc above the motors, and all files of the map."""
    printed = output(fmu, tmp_path, "workspace.py")
    assert "motors at 131.315 and 48.685 deg" in printed and "condition number 2.0444, assembly plus" in printed
    assert "so that it is 0.1185 m too far." in printed
    assert re.search(r"minusPlus, assembly plus: .* at \(0\.0500\d, 0\.2757\d\) m, radius 0\.1397\d m", printed)
    assert len(list((tmp_path / "target" / "workspace").iterdir())) == 21


def test_draw(fmu: Path, tmp_path: Path) -> None:
    """The robot draws as the docs show, with the same figures; a drawing too close to a singularity is refused with the place."""
    printed = output(fmu, tmp_path, "draw.py")
    assert "fivebar.svg: 16 strokes, 0.6668 m of lines in 18.67 s" in printed
    largest, mean = (
        float(x) for x in re.findall(r"from the drawing with the pen down: up to (\S+) mm, (\S+) mm rms", printed)[0]
    )
    text = (REPOSITORY / "docs" / "kinematics.md").read_text(encoding="utf-8")
    assert f"off the drawing by {mean:.3f} mm" in text and f"at most by {largest:.2f} mm" in text
    assert "Stroke 4, at (-0.0110795, 0.115359) m, meets a direct singularity" in printed
    names = {"drawn.svg", "drawn.png", "blocked.svg", "blocked.png", "fivebar.json", "fivebar.csv"}
    assert {file.name for file in (tmp_path / "target" / "draw").iterdir()} == names
