"""FMPy's simulate_fmu, and the script that docs/my-machine.md quotes."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_csv, simulate_fmu
from fmpy.util import create_plotly_figure

from conftest import REPOSITORY
from fivebar import simulate


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
    """With nothing set the unit makes the paper's free fall through many singularities, with constant energy."""
    names = ["tip.y", "energy.error", "singular.passes.direct", "singular.passes.inverse[1]"]
    result = simulate_fmu(str(fmu), output=names)
    assert result["time"][0] == 0 and result["time"][-1] == pytest.approx(50)
    assert np.ptp(result["tip.y"]) > 0.5, "a fall from 0.21 m above the motors to 0.4 m below them"
    assert result["singular.passes.direct"][-1] > 100 and result["singular.passes.inverse[1]"][-1] > 100
    # 1.69e-4 mgL, the README's line, is 5.9e-6 J.
    assert np.max(np.abs(result["energy.error"])) < 1e-5


@pytest.mark.full
def test_fmpy_draws_a_picture(fmu: Path, outputs: list[str]) -> None:
    """`fmpy simulate --show-plot` draws a curve for each output over the whole run."""
    figure = create_plotly_figure(simulate_fmu(str(fmu), output=outputs, stop_time=1))
    assert len(figure.data) == len(outputs) == 16
    assert all(curve.x[0] == 0 and curve.x[-1] == pytest.approx(1) for curve in figure.data)
    # Without servos, plane and estimator the last eight are constant.
    assert [np.ptp(curve.y) > 0 for curve in figure.data] == [True] * 8 + [False] * 8


def test_input_from_a_table(fmu: Path) -> None:
    """FMPy's own input table drives the motor."""
    torque = np.array([(0.0, 0.0), (0.1, 0.0), (0.1, 0.02), (0.2, 0.02)], dtype=[("time", float), ("tau[1]", float)])
    result = simulate_fmu(
        str(fmu),
        stop_time=0.2,
        output_interval=1e-3,
        start_values={"gravity.enabled": False},
        input=torque,
        output=["theta[1]"],
    )
    still = result["time"] <= 0.1
    assert np.all(result["theta[1]"][still] == result["theta[1]"][0])
    assert result["theta[1]"][-1] > result["theta[1]"][0] + 0.01


def test_the_table_of_a_run_is_input_of_fmpy(fmu: Path, tmp_path: Path) -> None:
    """FMPy keeps inputs constant over a step, as a run does: equal commands give equal bits."""
    own = simulate.run("pick_and_place", fmu=fmu)
    table = read_csv(own.to_csv(tmp_path / "run.csv"))
    result = simulate_fmu(
        str(fmu),
        stop_time=own.time[-1],
        output_interval=1e-3,
        start_values=own.scene.values,
        input=table,
        output=["theta[1]", "theta[2]"],
    )
    for name in ("theta[1]", "theta[2]"):
        assert result[name].tolist() == own[name].tolist()


def test_docs_and_example(fmu: Path, tmp_path: Path) -> None:
    """The Python code in docs/my-machine.md and its script run unchanged and agree."""
    environment = os.environ | {"FIVEBAR_FMU": str(fmu)}
    blocks = re.findall(
        r"^```python\n(.*?)^```$",
        (REPOSITORY / "docs" / "my-machine.md").read_text(encoding="utf-8"),
        re.DOTALL | re.MULTILINE,
    )
    package, live, plain = blocks

    def run(*arguments: str) -> "subprocess.CompletedProcess[str]":
        command = [sys.executable, *arguments]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)

    done = run("-c", package)
    assert re.fullmatch(r"-?0\.\d+ m\n", done.stdout) and (tmp_path / "tip.png").is_file(), done.stderr
    done = run("-c", live)
    # The PD controller keeps the initial posture.
    assert re.fullmatch(r"\(-0\.0\d+, 0\.2\d+\) m\n", done.stdout), done.stdout + done.stderr
    tips = []
    for arguments in (["-c", plain], [str(REPOSITORY / "examples" / "first_run.py")]):
        done = run(*arguments)
        assert done.returncode == 0, done.stderr
        tips.append([float(number) for number in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", done.stdout)])
    assert len(tips[0]) == 2 and tips[0] == pytest.approx(tips[1], abs=1e-6)
