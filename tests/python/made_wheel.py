"""Builds wheels of the package `fivebar` for tests."""

import os
import subprocess
import sys
from pathlib import Path

from conftest import REPOSITORY


def build(fmu: Path, folder: Path) -> Path:
    """A wheel around a unit."""
    command = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)]
    subprocess.run(
        command, cwd=REPOSITORY / "python", env=os.environ | {"FIVEBAR_FMU": str(fmu)}, check=True, capture_output=True
    )
    [wheel] = folder.glob("*.whl")
    return wheel
