"""Facts that the documentation repeats: start values of effects, the output of a run in docs/first-run.md, sizes of libraries."""

import io
import math
import re
import zipfile
from pathlib import Path

import pytest
from fmpy.model_description import ModelDescription, ScalarVariable

from conftest import REPOSITORY
from fivebar import singularities, summary
from fivebar.drive import Progress, drive
from fivebar.library import shared
from fivebar.scene import read
from fivebar.variables import unit

EFFECTS = ("gravity", "rotor", "payload", "viscous", "friction", "spring", "stop", "contact", "servo")

NUMBER = r"[−-]?(?:π(?:/\d)?|\d+(?:\.\d+)?(?:e-?\d+)?)"
QUANTITY = rf"({NUMBER})(?: ([A-Za-z·/²]+))?"
MILLI = 1e-3


def text(path: str) -> str:
    """A file of the repository."""
    return (REPOSITORY / path).read_text(encoding="utf-8")


def value(number: str) -> float:
    """The value of a match of NUMBER."""
    plain = number.replace("−", "-")
    if "π" not in plain:
        return float(plain)
    factor, _, divisor = plain.partition("π")
    return (-1 if factor else 1) * math.pi / float(divisor.removeprefix("/") or 1)


def as_in_the_xml(shown: str) -> str:
    """A unit as the model description has it."""
    return shown.replace("·", ".").replace("²", "2")


def parameters(model: ModelDescription, effect: str) -> dict[str, ScalarVariable]:
    """The parameters of an effect except its switch, by the part of the name after the effect."""
    named = {v.name.removeprefix(f"{effect}."): v for v in model.modelVariables if v.name.startswith(f"{effect}.")}
    return {name: v for name, v in named.items() if v.causality == "parameter" and name != "enabled"}


def test_every_effect_is_known(model: ModelDescription) -> None:
    assert {v.name for v in model.modelVariables if v.name.endswith(".enabled")} == {
        f"{name}.enabled" for name in (*EFFECTS, "estimator", "estimator.learn")
    }


@pytest.mark.parametrize("effect", EFFECTS)
def test_docs_have_the_start_values_of_effects(model: ModelDescription, effect: str) -> None:
    """Every parameter stands in the last column, with start value and unit: "tunable: `b[1..5]` 1e-4 N·m·s/rad"."""
    (row,) = re.findall(rf'^\| (?:{effect} \(|`{{"{effect}\.).* \| ([^|]*) \|$', text("docs/effects.md"), re.MULTILINE)
    stated = {}
    for name, count, number, shown in re.findall(rf"`(\w+)(?:\[1\.\.(\d)\])?` {QUANTITY}", row):
        for one in [f"{name}[{i + 1}]" for i in range(int(count))] if count else [name]:
            stated[one] = (value(number), as_in_the_xml(shown))
    known = parameters(model, effect)
    assert stated.keys() == known.keys()
    for name, (start, shown) in stated.items():
        assert start == float(known[name].start), name
        assert shown == unit(known[name]) or (not shown and (start == 0.0 or unit(known[name]) == "1")), name
    for variability, part in re.findall(r"(tunable|fixed): ([^;]*)", row):
        names = {f"{name}[1]" if count else name for name, count in re.findall(r"`(\w+)(\[1\.\.\d\])?`", part)}
        assert names and {known[name].variability for name in names} == {variability}


@pytest.mark.parametrize("effect", EFFECTS)
def test_sources_have_the_start_values_of_effects(model: ModelDescription, effect: str) -> None:
    """Every number after "Default" in the head of an effect's file is, up to sign, the start value of one of its parameters."""
    lines = text(f"src/effects/{effect}.rs").splitlines()
    head = " ".join(line.removeprefix("//!").strip() for line in lines if line.startswith("//!"))
    (defaults,) = re.findall(r"Defaults?: (.*?) Limits: ", head)
    known = [(abs(float(v.start)), unit(v)) for v in parameters(model, effect).values()]
    stated = re.findall(QUANTITY, defaults)
    assert stated
    for number, shown in stated:
        name, size = as_in_the_xml(shown), abs(value(number))
        if name not in {of for _, of in known} and name.startswith("m"):
            name, size = name[1:], size * MILLI
        fits = [start for start, of in known if math.isclose(start, size, rel_tol=1e-15) and name in ("", of)]
        assert fits, f"{number} {shown} is no start value of {effect}"


def test_the_first_run_prints_what_its_page_shows(fmu: Path, scenes: Path) -> None:
    """All lines of the summary, without times."""
    scene = read(scenes / "paper_free_fall.json")
    run = drive(shared(fmu), scene, scene.variants[0], Progress("", scene.stop_time, io.StringIO()))
    (block,) = re.findall(r"^```text\n(  tip at the end.*?)^```$", text("docs/first-run.md"), re.MULTILINE | re.DOTALL)

    def lasting(lines: list[str]) -> list[str]:
        return [line for line in lines if not line.startswith(("  wall time", "  real-time factor"))]

    assert lasting(block.splitlines()) == lasting(summary.lines(run, singularities.find(run)))


def test_readme_has_all_environment_variables() -> None:
    """All environment variables that the package, its scripts and the shared parts of the tests read."""
    table = text("README.md").split("| environment variable |")[1].split("\n\n")[0]
    files = [
        *REPOSITORY.glob("python/src/**/*.py"),
        *(file for file in REPOSITORY.glob("python/lifecycle/*") if file.is_file()),
        *(REPOSITORY / "tests" / "python" / name for name in ("conftest.py", "test_wheel.py", "test_import.py")),
    ]
    found = set()
    for file in files:
        source = file.read_text(encoding="utf-8")
        found |= {*re.findall(r"environ\.\w+\(\"(\w+)\"", source), *re.findall(r"\bFIVEBAR_[A-Z]+", source)}
    assert len(found) > 12 and [name for name in sorted(found) if f"`{name}`" not in table] == []


SIZES = dict(re.findall(r"^  binaries/([\w-]+)/FiveBar\.\w+: (\d+) bytes", text("docs/platforms.md"), re.MULTILINE))


def test_docs_have_sizes_below_their_limit() -> None:
    """Each library in docs/platforms.md is below the limit on that page, which is the packer's limit."""
    (sentence,) = re.findall(r"^- less than (.*) \(", text("docs/platforms.md"), re.MULTILINE)
    limits = {folder: most for most, folder in re.findall(r"([\d,]+) (?:bytes )?for ([\w-]+)", sentence)}
    assert SIZES.keys() == limits.keys() == {"aarch64-linux", "darwin64", "linux64", "win64"}
    for folder, most in limits.items():
        assert f'("{folder}", {most.replace(",", "_")})' in text("xtask/src/package/verify.rs")
        assert int(SIZES[folder]) < int(most.replace(",", ""))


@pytest.mark.platforms
def test_libraries_have_the_sizes_that_docs_say(fmu: Path) -> None:
    """Sizes of the unit for all platforms, within 10 %; a library for one machine contains another build of the standard library."""
    with zipfile.ZipFile(fmu) as archive:
        libraries = [item for item in archive.infolist() if item.filename.startswith("binaries/")]
    packed = {Path(item.filename).parent.name: item.file_size for item in libraries}
    assert packed.keys() == SIZES.keys()
    for platform, size in packed.items():
        assert size == pytest.approx(int(SIZES[platform]), rel=0.1), platform
