"""The scripts of examples/, as a user runs them: they end well and say what they promise."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import REPOSITORY


def output(fmu: Path, folder: Path, name: str) -> str:
    """What examples/`name` prints, run from a folder that has the .fmu where the repository has it."""
    (folder / "target" / "fmu").mkdir(parents=True)
    shutil.copy(fmu, folder / "target" / "fmu" / "FiveBar.fmu")
    command = [sys.executable, str(REPOSITORY / "examples" / name)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_switch_effects(fmu: Path, tmp_path: Path, model: object) -> None:
    """Every effect is shown, each ends elsewhere, the balances close, and the tuned spring acts one step after 0.5 s."""
    text = (REPOSITORY / "examples" / "switch_effects.py").read_text(encoding="utf-8")
    effects = [v.name for v in model.modelVariables if v.name.endswith(".enabled")]
    assert effects and all(f'"{effect}"' in text for effect in effects)
    printed = output(fmu, tmp_path, "switch_effects.py")
    rows = re.findall(r"^ *(\D.*?)  +(-?\d+\.\d{4}) +(-?\d+\.\d{4}) +(\d+\.\d{3}) +(\S+)$", printed, re.MULTILINE)
    assert len(rows) == 11 and len({row[1] for row in rows}) == 11
    # A fall's energy is some 0.1 J; what is lost in stiff stops and floors is below 1e-3 of it.
    assert all(abs(float(row[4])) < 1e-4 for row in rows)
    assert "the motion differs from t = 0.501 s on" in printed


def test_own_scene(fmu: Path, tmp_path: Path) -> None:
    """The push carries the tip to the right, and all energies are accounted for."""
    printed = output(fmu, tmp_path, "own_scene.py")
    start, furthest = (float(x) for x in re.findall(r"tip at x = (\S+) m", printed)[:2])
    assert furthest > start + 0.005
    assert float(re.findall(r"balance residual (\S+) J", printed)[0]) < 1e-6


@pytest.mark.parametrize("path", sorted((REPOSITORY / "examples").glob("*.py")), ids=lambda path: path.name)
def test_examples_are_short(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) < 80
