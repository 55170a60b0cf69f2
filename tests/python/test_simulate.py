"""The plain way: simulate_fmu, and the script that the README quotes."""

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from fmpy import simulate_fmu

from conftest import PATIENCE, REPOSITORY


def test_five_lines(fmu: Path) -> None:
    result = simulate_fmu(
        str(fmu),
        stop_time=0.3,
        output_interval=0.01,
        start_values={"init.theta[2]": 2.0943951023931953},
        output=["tip.x", "tip.y", "energy.error"],
    )
    assert len(result) == 31 and result["time"][-1] == pytest.approx(0.3)
    # 0.3 s of tests/data/reference/fall-90-120.csv
    assert (result["tip.x"][-1], result["tip.y"][-1]) == pytest.approx((0.0629559, 0.1081033), abs=1e-4)
    assert np.max(np.abs(result["energy.error"])) < 1e-5


def test_the_default_experiment_is_interesting(fmu: Path) -> None:
    """As it stands, with no argument but what to look at: the paper's free fall through many singularities, with its energy kept."""
    names = ["tip.y", "energy.error", "singular.passes.direct", "singular.passes.inverse[1]"]
    result = simulate_fmu(str(fmu), output=names)
    assert result["time"][0] == 0 and result["time"][-1] == pytest.approx(50)
    assert np.ptp(result["tip.y"]) > 0.5, "a fall from 0.21 m above the motors to 0.4 m below them"
    assert result["singular.passes.direct"][-1] > 100 and result["singular.passes.inverse[1]"][-1] > 100
    # 1.69e-4 mgL, the README's line, is 5.9e-6 J.
    assert np.max(np.abs(result["energy.error"])) < 1e-5


@pytest.mark.full
def test_fmpy_draws_a_picture(fmu: Path, outputs: list[str], tmp_path: Path) -> None:
    """`fmpy simulate FiveBar.fmu --show-plot`, in a browser that takes a picture of what it is shown: a row for every output, each with
    its curve from the beginning to the end, that of whatever moves with its ups and downs."""
    picture = tmp_path / "picture.png"
    browser = "chromium --headless=new --no-sandbox --disable-gpu --hide-scrollbars --window-size=1280,1600 --virtual-time-budget=8000"
    environment = os.environ | {"BROWSER": f"{browser} --user-data-dir={tmp_path / 'profile'} --screenshot={picture} %s &"}
    command = [str(Path(sys.executable).parent / "fmpy"), "simulate", str(fmu), "--show-plot"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = rows_of_curves(picture)
    assert len(rows) == len(outputs) == 16
    assert all(width > 0.85 * 1280 for _, width in rows)
    # A variable at rest is a line of 1 or 2 pixels: without servos, plane and estimator, the last eight. Sixteen rows leave 8 to the others.
    assert [height > 4 for height, _ in rows] == [True] * 8 + [False] * 8


def rows_of_curves(picture: Path) -> list[tuple[int, int]]:
    """Height and width, in pixels, of each row in which FMPy's blue stands; waits until the picture is written."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            red, _, blue = np.moveaxis(matplotlib.image.imread(picture)[:, :, :3], 2, 0)
            break
        except (OSError, SyntaxError):
            assert time.monotonic() < end, "the browser has taken no picture"
            time.sleep(0.2)
    # Bright blue on white, also where a line lies between two rows of pixels; text is dark.
    curve = (blue > 0.7) & (blue - red > 0.3)
    # Below the icons of the page.
    curve[:28, 900:] = False
    lines = np.flatnonzero(curve.any(axis=1))
    bands = np.split(lines, np.flatnonzero(np.diff(lines) > 10) + 1)
    columns = [np.flatnonzero(curve[band].any(axis=0)) for band in bands]
    return [(int(band[-1] - band[0] + 1), int(column[-1] - column[0] + 1)) for band, column in zip(bands, columns, strict=True)]


def test_input_from_a_table(fmu: Path) -> None:
    """FMPy's own input table drives the motor."""
    torque = np.array([(0.0, 0.0), (0.1, 0.0), (0.1, 0.02), (0.2, 0.02)], dtype=[("time", float), ("tau[1]", float)])
    result = simulate_fmu(
        str(fmu), stop_time=0.2, output_interval=1e-3, start_values={"gravity.enabled": False}, input=torque, output=["theta[1]"]
    )
    still = result["time"] <= 0.1
    assert np.all(result["theta[1]"][still] == result["theta[1]"][0])
    assert result["theta[1]"][-1] > result["theta[1]"][0] + 0.01


def test_readme_and_example(fmu: Path, tmp_path: Path) -> None:
    """The Python in the README and the script it names, as they stand, run and agree."""
    (tmp_path / "target" / "fmu").mkdir(parents=True)
    shutil.copy(fmu, tmp_path / "target" / "fmu" / "FiveBar.fmu")
    blocks = re.findall(r"^```python\n(.*?)^```$", (REPOSITORY / "README.md").read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    package, plain = blocks
    done = subprocess.run([sys.executable, "-c", package], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert re.fullmatch(r"-?0\.\d+ m\n", done.stdout) and (tmp_path / "tip.png").is_file(), done.stderr
    tips = []
    for arguments in (["-c", plain], [str(REPOSITORY / "examples" / "first_run.py")]):
        done = subprocess.run([sys.executable, *arguments], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        tips.append([float(number) for number in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", done.stdout)])
    assert len(tips[0]) == 2 and tips[0] == pytest.approx(tips[1], abs=1e-6)
