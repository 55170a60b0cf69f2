"""The units under test, each extracted once per session: FIVEBAR_FMU and FIVEBAR_OWN, or the files from `cargo xtask package`."""

import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import fmpy
import pytest
from fmpy.model_description import ModelDescription

from fivebar.library import Library
from instance import Instance

REPOSITORY = Path(__file__).resolve().parents[2]

PATIENCE = 300.0
"""Seconds after which a process counts as hung. No test judges speed by it: a busy machine may be many times slower than an idle one."""

# Files with the longest tests, to run first: a long test that starts last would keep one of the two processes waiting.
LONGEST = ("test_conformance.py", "test_twin_full.py", "test_wheel.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Moves the slowest files to the front."""
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))


class FailureNames:
    """Names a failed test as soon as it has failed: the names are known also of a run that is stopped."""

    def __init__(self, config: pytest.Config):
        self.config = config

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        reporter = self.config.pluginmanager.get_plugin("terminalreporter")
        if report.failed and reporter is not None:
            reporter.write_line(f"\n{report.nodeid} failed")


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(FailureNames(config))


def wait_until(holds: Callable[[], Any], seconds: float = PATIENCE) -> None:
    """Waits until a condition is true; shorter times than `PATIENCE` are for retries."""
    begin = time.monotonic()
    while not holds():
        assert time.monotonic() - begin < seconds, f"not within {seconds:g} s"
        time.sleep(0.02)


def started(run: "subprocess.Popen[str]") -> str:
    """The line with the addresses that `fivebar twin` prints after the start; on a busy machine warnings may come before it."""
    assert run.stdout is not None
    lines: list[str] = []
    for line in run.stdout:
        lines.append(line)
        if line.startswith("broker at "):
            return line
    raise AssertionError("".join(lines))


def settle(driver: Any) -> None:
    """Prepares a shared browser for the next test: resets screen, colours and processor, and leaves the page. The console is checked last, so
    that a failed test does not affect the next."""
    problems = driver.get_log("browser")
    driver.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": 1})
    driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    # A page in the background would go on drawing.
    driver.get("about:blank")
    assert problems == []


@pytest.fixture(autouse=True)
def working_directory() -> Iterator[None]:
    """Each test leaves the working directory as it was."""
    before = os.getcwd()
    yield
    after = os.readlink("/proc/self/cwd")
    os.chdir(before)
    assert after == before, f"the test left the process in {after}"


@pytest.fixture(scope="session")
def fmu() -> Path:
    """The packed .fmu."""
    path = Path(os.environ.get("FIVEBAR_FMU", REPOSITORY / "target" / "fmu" / "FiveBar.fmu")).resolve()
    assert path.is_file(), f"there is no .fmu at {path}: run `cargo xtask package` or set FIVEBAR_FMU"
    return path


@pytest.fixture(scope="module")
def library(fmu: Path) -> Iterator[Library]:
    """The unit under test, extracted and loaded by the package."""
    made = Library(fmu)
    yield made
    made.close()


@pytest.fixture(scope="session")
def directory(fmu: Path) -> Iterator[str]:
    """The folder of the extracted .fmu."""
    folder = fmpy.extract(str(fmu))
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="session")
def model(directory: str) -> ModelDescription:
    """The model description, as FMPy reads it."""
    return fmpy.read_model_description(directory)


@pytest.fixture(scope="session")
def outputs(model: ModelDescription) -> list[str]:
    """Names of the outputs."""
    return [v.name for v in model.modelVariables if v.causality == "output"]


class Unit(NamedTuple):
    """A packed unit."""

    fmu: Path
    directory: str
    model: ModelDescription


@pytest.fixture(scope="session")
def own(tmp_path_factory: pytest.TempPathFactory) -> Unit:
    """The unit of one's own: FIVEBAR_OWN, or the file from `cargo xtask package --scene tests/data/own_machine.json`."""
    path = Path(os.environ.get("FIVEBAR_OWN", REPOSITORY / "target" / "fmu" / "OwnMachine.fmu")).resolve()
    assert path.is_file(), f"there is no .fmu at {path}: run `cargo xtask package --scene tests/data/own_machine.json`"
    directory = fmpy.extract(str(path), unzipdir=str(tmp_path_factory.mktemp("own")))
    return Unit(path, directory, fmpy.read_model_description(directory))


@pytest.fixture(scope="session")
def scenes() -> Path:
    """Folder of the shipped scenes."""
    return REPOSITORY / "scenes"


def maker(model: ModelDescription, directory: str) -> Iterator[Callable[..., Instance]]:
    """Makes instances and frees them after the test."""
    made: list[Instance] = []

    def make(name: str = "fivebar", logging_on: bool = False) -> Instance:
        made.append(Instance(model, directory, name, logging_on))
        return made[-1]

    yield make
    for instance in made:
        instance.slave.freeInstance()


@pytest.fixture
def new(model: ModelDescription, directory: str) -> Iterator[Callable[..., Instance]]:
    """Makes instances of the plain unit."""
    yield from maker(model, directory)


@pytest.fixture
def new_own(own: Unit) -> Iterator[Callable[..., Instance]]:
    """Makes instances of the unit of one's own."""
    yield from maker(own.model, own.directory)
