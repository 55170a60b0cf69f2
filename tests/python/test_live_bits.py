"""The live page's library and modules in node against the library for this machine: every scene, every method, every bit.

Needs node and the page: `cargo xtask test --page` makes it and runs this.
"""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription

from conftest import REPOSITORY
from fivebar.scene import read
from fivebar.variables import Variables
from instance import Log, instantiate, set_values

pytestmark = pytest.mark.page

SITE = REPOSITORY / "target" / "page" / "site"
SCENES = sorted(path.stem for path in (REPOSITORY / "scenes").glob("*.json"))


def methods(model: ModelDescription) -> dict[str, int]:
    """The methods and their numbers."""
    return {item.name: int(item.value) for item in next(t for t in model.typeDefinitions if t.name == "Method").items}


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the files that node wrote."""
    folder = tmp_path_factory.mktemp("bits")
    subprocess.run(["node", REPOSITORY / "tests" / "page" / "bits.mjs", SITE, folder], check=True)
    return folder


@pytest.mark.parametrize("scene", SCENES)
def test_the_page_computes_the_bits_of_the_unit(
    scene: str, ran: Path, scenes: Path, model: ModelDescription, directory: str
) -> None:
    """All computed variables are equal at each millisecond; if a method refuses a scene, the sentences are equal."""
    content = read(scenes / f"{scene}.json", Variables(model)).resolved()
    names = json.loads((ran / "variables.json").read_text())
    references = {v.name: v.valueReference for v in model.modelVariables}
    real, integer = ([references[name] for name in names[kind]] for kind in ("real", "integer"))
    assert len(real) + len(integer) == sum(
        v.causality in ("output", "local") and v.derivative is None for v in model.modelVariables
    )
    steps = min(1000, round(1000 * content["stopTime"]))
    for method, number in methods(model).items():
        log = Log()
        slave = instantiate(model, directory, log)
        reals, integers, said = [], [], ""
        signals = content["signals"]
        try:
            set_values(slave, model, content["variants"][0]["values"] | {"solver.method": number})
            set_values(slave, model, {name: values[0] for name, values in signals.items()})
            slave.setupExperiment()
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            reals.append(slave.getReal(real))
            integers.append(slave.getInteger(integer))
            for i in range(steps):
                if signals:
                    slave.setReal([references[name] for name in signals], [values[i] for values in signals.values()])
                slave.doStep(i * 0.001, 0.001)
                reals.append(slave.getReal(real))
                integers.append(slave.getInteger(integer))
        except FMICallException:
            said = log.last()
        slave.freeInstance()
        file = ran / f"{scene}-{method}"
        assert file.with_suffix(".txt").read_text() == said, method
        for kind, expected, number_type in (("real", reals, np.float64), ("integer", integers, np.int32)):
            found = np.fromfile(file.with_suffix(f".{kind}"), number_type).reshape(-1, len(names[kind]))
            wanted = np.array(expected, number_type).reshape(-1, len(names[kind]))
            assert found.shape == wanted.shape, method
            unequal = np.argwhere(found.view(np.uint8) != wanted.view(np.uint8))
            if len(unequal):
                moment, byte = unequal[0]
                column = byte // number_type().itemsize
                place = f"{names[kind][column]} at {moment} ms"
                raise AssertionError(
                    f"{method}: {place} is {found[moment, column]!r}, natively {wanted[moment, column]!r}"
                )


def test_every_scene_has_run(ran: Path, model: ModelDescription) -> None:
    """No scene and no method is missing, and most of them run."""
    files = {path.stem for path in ran.glob("*.txt")}
    assert files == {f"{scene}-{method}" for scene in SCENES for method in methods(model)}
    refused = [path.stem for path in ran.glob("*.txt") if path.read_text()]
    assert len(refused) < len(files) / 4, refused
