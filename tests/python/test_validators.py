"""The validators run: each notices what is wrong in copies of the .fmu that were broken on purpose.

None of them sees everything; what is seen by our own checks alone, those of test_package, is in the table as well.
"""

import inspect
import re
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path

import fmpy.validation
import pytest
from lxml import etree

import test_package


@dataclass(frozen=True)
class Break:
    """Text that is replaced in modelDescription.xml, once, and the validators that must notice; @ before a name stands for its index."""

    name: str
    old: str
    new: str
    seen_by: tuple[str, ...]


BREAKS = [
    Break("an attribute that FMI does not know", 'modelName="FiveBar"', 'modelName="FiveBar" colour="red"', ("fmpy", "fmutool")),
    Break("a unit that is not defined", '<Unit name="kg.m2">', '<Unit name="stone">', ("fmpy", "own")),
    Break("exponents of another unit", '<BaseUnit kg="1" m="2"/>', '<BaseUnit kg="1" m="3"/>', ("own",)),
    Break("a type that is not declared", 'declaredType="Count" start="10"', 'declaredType="Number" start="10"', ("fmpy", "own")),
    Break("two variables of one name", 'name="tip.y"', 'name="tip.x"', ("fmpy", "fmutool", "own")),
    Break("two variables of one reference", 'valueReference="611"', 'valueReference="610"', ("own",)),
    Break("a name that is not structured", 'name="tip.y"', 'name="tip y"', ("fmpy", "own")),
    Break("an input with initial", 'causality="input"', 'causality="input" initial="exact"', ("fmutool", "own")),
    Break(
        "a start value of an output",
        '<Real declaredType="Position"/>',
        '<Real declaredType="Position" start="0"/>',
        ("fmpy", "fmutool", "own"),
    ),
    Break("a start value outside its bounds", 'start="10" min="1" max="100"', 'start="0" min="1" max="100"', ("own",)),
    Break("bounds the wrong way round", 'start="10" min="1" max="100"', 'start="10" min="100" max="1"', ("own",)),
    Break("an output that is not listed", '<Unknown index="@theta[1]" dependencies="@theta[1]"/>', "", ("fmpy", "fmutool", "own")),
    Break("a dependency on nothing", 'index="@theta[1]" dependencies="@theta[1]"', 'index="@theta[1]" dependencies="9700"', ("own",)),
    Break("a log category that is not used", 'name="logEvents"', 'name="logMore"', ("own",)),
]


def with_indices(text: str, description: bytes) -> bytes:
    """The text with the indices of variables in a model description."""
    names = [v.get("name") for v in etree.fromstring(description).iterfind("ModelVariables/ScalarVariable")]
    return re.sub(r"@([\w.\[\]]+)", lambda name: str(1 + names.index(name[1])), text).encode()


@pytest.fixture
def broken(fmu: Path, tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """A copy of the .fmu with the change that the test was given."""
    change: Break = request.param
    copy = tmp_path / "FiveBar.fmu"
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(copy, "w") as target:
        for item in source.infolist():
            content = source.read(item)
            if item.filename == "modelDescription.xml":
                old, new = (with_indices(text, content) for text in (change.old, change.new))
                assert old in content, f"there is no {change.old} to break"
                content = content.replace(old, new, 1)
            target.writestr(item, content)
    return copy


def seen_by(name: str) -> pytest.MarkDecorator:
    """All changes that `name` must notice."""
    changes = [change for change in BREAKS if name in change.seen_by]
    return pytest.mark.parametrize("broken", changes, ids=lambda change: change.name, indirect=True)


@seen_by("fmpy")
def test_fmpy_notices(broken: Path) -> None:
    assert fmpy.validation.validate_fmu(str(broken)) != []


@pytest.mark.full
@seen_by("fmutool")
def test_fmutool_notices(broken: Path) -> None:
    command = [str(Path(sys.executable).parent / "fmutool"), "-input", str(broken), "-check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 7, done.stdout  # its code for "not compliant"; a crash has another one


@seen_by("own")
def test_our_own_checks_notice(broken: Path) -> None:
    with zipfile.ZipFile(broken) as archive:
        root = etree.fromstring(archive.read("modelDescription.xml"))
    given = {"root": root, "variables": root.findall("ModelVariables/ScalarVariable")}
    noticed = 0
    for name, check in inspect.getmembers(test_package, inspect.isfunction):
        wanted = inspect.signature(check).parameters
        if name.startswith("test_") and set(wanted) <= set(given):
            try:
                check(**{parameter: given[parameter] for parameter in wanted})
            except (AssertionError, ValueError):
                noticed += 1
    assert noticed > 0
