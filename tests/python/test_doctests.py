"""The examples in the docstrings of the public modules run and show what they say."""

import doctest
import importlib
from pathlib import Path

import matplotlib as mpl
import pytest

import fivebar

MODULES = (
    "fivebar",
    "fivebar.errors",
    "fivebar.kinematics",
    "fivebar.result",
    "fivebar.scene",
    "fivebar.twin.calibrate.calibration",
)


@pytest.fixture(autouse=True)
def here(fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty folder, for examples write files, and no windows."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FIVEBAR_FMU", str(fmu))
    mpl.use("agg")


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_run(name: str) -> None:
    failed, tried = doctest.testmod(
        importlib.import_module(name), optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    )
    assert failed == 0 < tried


def test_what_the_package_offers_is_documented_and_has_an_example() -> None:
    """Each name of `fivebar`; notebooks complete also those that are loaded when they are asked for."""
    for name in fivebar.__all__:
        offered = getattr(fivebar, name)
        assert name in dir(fivebar) and (offered.__doc__ or "").strip(), name
        assert name == "FiveBarError" or doctest.DocTestFinder().find(offered, name, module=False), name
    with pytest.raises(AttributeError, match="has no attribute 'Results'"):
        _ = fivebar.Results  # type: ignore[attr-defined]
