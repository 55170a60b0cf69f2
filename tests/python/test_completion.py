"""Shell completion, called as the shells call it: fast, from the named unit, and empty without a unit."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fivebar
from fivebar.variables import of_unit

CODE = """
import sys
from fivebar.commands import main
try:
    main(sys.argv[1:])
finally:
    print("heavy:", sorted({"fmpy", "numpy", "matplotlib"} & set(sys.modules)))
"""


def completed(*words: str, fmu: Path | None = None, shell: str = "bash") -> list[str]:
    """Completions of the last word; for zsh with type and help."""
    environment = os.environ | {
        "_FIVEBAR_COMPLETE": f"{shell}_complete",
        "COMP_WORDS": " ".join(["fivebar", *words]),
        "COMP_CWORD": str(len(words)),
    }
    if fmu is not None:
        environment["FIVEBAR_FMU"] = str(fmu)
    command = [sys.executable, "-c", CODE]
    answer = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert answer.stderr == ""
    *lines, heavy = answer.stdout.splitlines()
    assert heavy == "heavy: []"
    return [line.removeprefix("plain,") for line in lines if line]


@pytest.mark.parametrize(
    "words",
    [("run",), ("map",), ("path",), ("unit", "--scene"), ("twin", "--scene"), ("calibrate", "--scene"), ("validate", "--scene"), ("check",)],
    ids=" ".join,
)  # fmt: skip
def test_scenes(words: tuple[str, ...], fmu: Path) -> None:
    """Files come before the scenes, because the script for bash drops words before files."""
    assert completed(*words, "fall", fmu=fmu) == ["file,fall", "fall_90_120"]


def test_scenes_have_descriptions(fmu: Path) -> None:
    lines = completed("run", "swing", fmu=fmu, shell="zsh")
    assert lines == ["file", "swing", "_", "plain", "swing", fivebar.scenes()["swing"]]


def test_names(fmu: Path) -> None:
    """Names of parameters and inputs, columns, and methods come from the unit."""
    known = of_unit(fmu)
    assert completed("run", "swing", "--set", "", fmu=fmu) == [f"{name}=" for name in known.start]
    assert completed("run", "swing", "--set", "gravity.g", fmu=fmu) == ["gravity.g="]
    assert completed("run", "swing", "--outputs", "tip.v", fmu=fmu) == ["tip.vx", "tip.vy"]
    assert completed("run", "swing", "--outputs", "theta,tip.vx,energy.er", fmu=fmu) == ["theta,tip.vx,energy.error"]
    assert not any("der(" in name for name in completed("run", "swing", "--outputs", "", fmu=fmu))
    assert completed("run", "swing", "--method", "", fmu=fmu) == list(known["solver.method"].items)


def test_values_that_have_names(fmu: Path) -> None:
    assert completed("run", "--set", "init.assembly=", fmu=fmu) == ["init.assembly=plus", "init.assembly=minus"]
    assert completed("run", "--set", "gravity.enabled=t", fmu=fmu) == ["gravity.enabled=true"]
    for given in ("tau[1]=", "tau[3]="):
        assert completed("run", "--set", given, fmu=fmu) == []


def test_the_unit_that_is_named(fmu: Path, tmp_path: Path) -> None:
    """Without a unit, nothing is completed and nothing is printed."""
    broken = tmp_path / "broken.fmu"
    broken.write_text("no archive")
    assert completed("run", "--fmu", str(tmp_path / "none.fmu"), "--method", "", fmu=fmu) == []
    assert completed("run", "--method", "", fmu=broken) == completed("run", "--method", "", fmu=tmp_path / "none") == []
    assert completed("run", "--fmu", str(fmu), "--method", "i3alpC", fmu=broken) == ["i3alpConserving"]


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_the_script_for_bash_is_printed(fmu: Path) -> None:
    environment = os.environ | {"_FIVEBAR_COMPLETE": "bash_source"}
    answer = subprocess.run(
        [sys.executable, "-m", "fivebar"], env=environment, capture_output=True, text=True, check=True
    )
    assert "complete -o nosort -F _fivebar_completion fivebar" in answer.stdout
