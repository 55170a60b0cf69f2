"""The package with the oldest packages that python/pyproject.toml allows."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import PATIENCE, REPOSITORY
from made_wheel import build

pytestmark = pytest.mark.nightly

TABLES = """
import fivebar
import pandas

fall = fivebar.run("end_stops", stop_time=0.3, outputs=("tip", "singular.type"))
assert len(pandas.DataFrame(fall)) == 301 and fall.to_dataframe().attrs["units"]["tip.x"] == "m"
assert fall.to_xarray()["singular.type"].attrs["flag_values"] == [1, 2, 3, 4, 5]
assert fall.to_parquet("fall.parquet").is_file() and "image/png" in fall._repr_html_()
"""


def test_the_twin_and_tables_with_the_oldest_allowed_packages(fmu: Path, tmp_path: Path) -> None:
    """The twin runs for five seconds, and a short run writes its table.

    Only wheels are installed: a version without one for this Python counts as too old.
    """
    environment = tmp_path / "environment"
    programs = environment / ("Scripts" if sys.platform == "win32" else "bin")

    def run(*command: str | Path) -> None:
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env=os.environ | {"UV_SYSTEM_CERTS": "1"},
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE,
        )
        # Exit code 3: on a busy machine forecasts come late.
        assert done.returncode in ((0, 3) if command[0] == programs / "fivebar" else (0,)), done.stdout + done.stderr

    uv = REPOSITORY / "target" / "uv" / "bin" / "uv"
    run(uv, "venv", "--python", sys.executable, environment)
    install = (uv, "pip", "install", "--only-binary", ":all:", "--python", programs / "python")
    run(
        *install,
        "--resolution",
        "lowest-direct",
        "--requirement",
        REPOSITORY / "python" / "pyproject.toml",
        "--extra",
        "twin",
        "--extra",
        "data",
    )
    run(*install, "--no-deps", build(fmu, tmp_path))
    run(programs / "python", "-c", TABLES)
    run(programs / "fivebar", "twin", "--seconds", "5")
