"""Dependencies of the wheel for other versions of Python, resolved by pip.

Part of `cargo xtask test --platforms`, because the registry takes half a minute to answer for each.
"""

import subprocess
from pathlib import Path

import pytest

from conftest import REPOSITORY
from made_wheel import build

pytestmark = pytest.mark.platforms


@pytest.mark.parametrize("version", ["3.12", "3.13", "3.14"])
def test_newer_pythons_have_all_dependencies(version: str, fmu: Path, tmp_path: Path) -> None:
    """pip resolves them for that Python without installing them."""
    # The environment of the tests has no pip; the environment of uv has one.
    python = REPOSITORY / "target" / "uv" / "bin" / "python"
    command = [python, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed", "--only-binary", ":all:"]
    where = ["--python-version", version, "--target", str(tmp_path / "packages"), f"{build(fmu, tmp_path)}[all]"]
    done = subprocess.run([*command, *where], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
