"""Many runs in parallel processes: bits equal to single runs, failures, reductions, scripts."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

import fivebar
from fivebar.errors import FiveBarError
from fivebar.result import Result
from fivebar.scene import read

MASSES = [{"link[1].mass": mass} for mass in (0.01, 0.02, 0.03)]
HOPELESS: dict[str, Any] = {"tau[1]": 50.0, "solver.adaptive": False, "solver.maxIterations": 3}
UNREACHABLE = {"init.theta[1]": np.pi, "init.theta[2]": 0.0}


def end(result: Result) -> tuple[float, int]:
    """Reduces a run to a few values and the id of its process."""
    return float(result["tip.x"][-1]), os.getpid()


@pytest.fixture(autouse=True)
def unit(fmu: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FIVEBAR_FMU", str(fmu))


def test_many_runs_are_those_one_by_one(capsys: pytest.CaptureFixture[str]) -> None:
    """Results are equal to the bit and in the order of the arguments."""
    many = fivebar.run_many("swing", MASSES, stop_time=0.1, outputs="tip.x", inputs={"tau[1]": 0.01}, processes=2)
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1] == "3 of 3 runs" and len(lines) == 3
    for values, result in zip(MASSES, many, strict=True):
        alone = fivebar.run("swing", stop_time=0.1, outputs="tip.x", inputs={"tau[1]": 0.01}, **values)
        assert result.outputs == ["time", "tip.x"]
        assert result["tip.x"].tobytes() == alone["tip.x"].tobytes() and result.own.parameters == alone.own.parameters


def test_scenes_and_reductions() -> None:
    """A list of scenes; the reduction runs in the process of the result."""
    scenes = [read("swing").replace(stop_time=0.05), "fall_90_120", {"experiment": {"stopTime": 0.05}}]
    found = fivebar.run_many(scenes, MASSES, reduce=end, processes=2, progress=False, stop_time=0.05)
    assert len({place for place, _ in found}) == 3 and os.getpid() not in {process for _, process in found}
    here = fivebar.run_many(scenes, MASSES, reduce=end, processes=1, progress=False, stop_time=0.05)
    assert [place for place, _ in here] == [place for place, _ in found] and {p for _, p in here} == {os.getpid()}


def test_each_row_of_a_frame_is_a_run() -> None:
    frame = pandas.DataFrame(
        {"link[1].mass": [0.01, 0.02], "payload.enabled": [True, False], "friction.law": "smooth"}, index=[5, 7]
    )
    found = fivebar.run_many("swing", frame, processes=1, progress=False, stop_time=0.01, outputs="tip.x")
    wanted = [(0.01, True), (0.02, False)]
    assert [(run.scene["link[1].mass"], run.scene["payload.enabled"]) for run in found] == wanted


@pytest.mark.parametrize("processes", [1, 2])
def test_runs_that_fail(processes: int) -> None:
    """A failed run is in its place with its partial result, or is the error of the whole call."""
    values = [{}, HOPELESS, UNREACHABLE]
    kept = fivebar.run_many("swing", values, stop_time=0.1, on_failure="return", processes=processes, progress=False)
    whole, failed, refused = kept
    assert whole.failure is None and len(whole.time) == 101
    assert isinstance(failed, fivebar.StepFailed) and str(failed).startswith("run 1: swing ended early, after t = ")
    assert failed.result is not None and 1 < len(failed.result.time) < 101
    assert isinstance(refused, FiveBarError) and str(refused).startswith("run 2: ") and "0.84" in str(refused)
    with pytest.raises(fivebar.StepFailed, match=r"^run 1: swing ended early"):
        fivebar.run_many("swing", values[:2], stop_time=0.1, processes=processes, progress=False)


def test_impossible_runs_are_one_sentence() -> None:
    """The error comes before the first run."""
    with pytest.raises(FiveBarError, match=r"^run 1: 'link\[1\]\.mass' must be a number in kg"):
        fivebar.run_many("swing", [{}, {"link[1].mass": -1}])
    with pytest.raises(
        FiveBarError, match=r"^there are 2 scenes and 3 dicts of values: one scene, or one for each dict, is needed$"
    ):
        fivebar.run_many(["swing", "bounce"], MASSES)
    with pytest.raises(FiveBarError, match=r"^'processes' must be a whole number of at least 1, not 0$"):
        fivebar.run_many("swing", MASSES, processes=0)
    assert fivebar.run_many([]) == [] == fivebar.run_many("swing", [])


def test_a_script_without_its_guard_says_what_is_missing(tmp_path: Path) -> None:
    """Each process imports the script and, without the guard, would start all runs again."""
    script = tmp_path / "sweep.py"
    call = "print(len(fivebar.run_many('swing', [{}, {}], stop_time=0.01, processes=2)))"
    script.write_text(f"import fivebar\n{call}\n")
    wrong = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert wrong.returncode == 1 and 'a script must call run_many below `if __name__ == "__main__":`' in wrong.stderr
    assert wrong.stderr.count("Traceback") == 1 and wrong.stderr.splitlines()[-1].startswith(
        "fivebar.errors.FiveBarError"
    )
    script.write_text(f"import fivebar\nif __name__ == '__main__':\n    {call}\n")
    right = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert right.stdout == "2\n"
