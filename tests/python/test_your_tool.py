"""docs/your-tool.md: scripts for programs available here run unchanged and print the stated output."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fivebar
from conftest import REPOSITORY

BLOCKS = re.findall(
    r"^## (\w+)\n\n```python\n(.*?)^```$",
    (REPOSITORY / "docs" / "your-tool.md").read_text(encoding="utf-8"),
    re.DOTALL | re.MULTILINE,
)


def tip(tool: str, fmu: Path, folder: Path) -> list[float]:
    """The two numbers on the last line that has only two numbers; masters log to the same stream, with times."""
    shutil.copy(fmu, folder / "FiveBar.fmu")
    done = subprocess.run(
        [sys.executable, "-c", dict(BLOCKS)[tool]], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    numbers = [line for line in done.stdout.splitlines() if re.fullmatch(r"[\[\]\d\s.,e+-]+", line)]
    return [float(number) for number in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", numbers[-1])]


def test_fmpy(fmu: Path, tmp_path: Path) -> None:
    ours = fivebar.run("fall_90_120", method="automatic", **{"init.theta[2]": 2.0944})
    assert tip("FMPy", fmu, tmp_path) == [ours["tip.x"][-1], ours["tip.y"][-1]]


@pytest.mark.full
def test_libcosim(fmu: Path, tmp_path: Path) -> None:
    ours = fivebar.run("fall_90_120", **{"init.theta[2]": 2.0944})
    assert tip("libcosim", fmu, tmp_path) == [ours["tip.x"][-1], ours["tip.y"][-1]]
