"""The examples in the docstrings of the public modules run and print the stated output."""

import doctest
import importlib
import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

import fivebar
from fivebar import kinematics

MODULES = (
    "fivebar",
    "fivebar.errors",
    "fivebar.instance",
    "fivebar.kinematics",
    "fivebar.result",
    "fivebar.scene",
    "fivebar.twin.calibrate.calibration",
)


@pytest.fixture(autouse=True)
def here(fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty working directory, because examples write files; no windows open."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FIVEBAR_FMU", str(fmu))
    mpl.use("agg")


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_run(name: str) -> None:
    failed, tried = doctest.testmod(
        importlib.import_module(name), optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    )
    assert failed == 0 < tried


def functions() -> Iterator[tuple[str, Callable[..., Any]]]:
    """The functions of `fivebar` and of its kinematics, and the methods of the classes that `fivebar` offers, by name."""
    for name in fivebar.__all__:
        offered = getattr(fivebar, name)
        if not inspect.isclass(offered):
            yield name, offered
            continue
        for member in dir(offered):
            method = getattr(offered, member)
            # Without the methods of dict and ValueError.
            if not member.startswith("_") and inspect.isroutine(method) and hasattr(method, "__code__"):
                yield f"{name}.{member}", method
    yield from ((name, getattr(kinematics, name)) for name in ("mode_name", "sines"))


@pytest.mark.parametrize(("name", "function"), list(functions()))
def test_functions_have_all_sections(name: str, function: Callable[..., Any]) -> None:
    """Parameters if there are any, returns, and an example, in the style of numpy."""
    written = inspect.getdoc(function) or ""
    signature = inspect.signature(function)
    wanted = {"Examples"}
    if [parameter for parameter in signature.parameters if parameter != "self"]:
        wanted.add("Parameters")
    if signature.return_annotation not in (None, "None"):
        wanted.add("Returns")
    missing = [title for title in sorted(wanted) if f"\n{title}\n{'-' * len(title)}\n" not in written]
    assert not missing, name


def test_what_the_package_offers_is_documented_and_has_an_example() -> None:
    """Each name of `fivebar`; notebooks also complete names that are loaded at first use."""
    for name in fivebar.__all__:
        offered = getattr(fivebar, name)
        assert name in dir(fivebar) and (offered.__doc__ or "").strip(), name
        assert name == "FiveBarError" or doctest.DocTestFinder().find(offered, name, module=False), name
    with pytest.raises(AttributeError, match="has no attribute 'Results'"):
        _ = fivebar.Results  # type: ignore[attr-defined]
