"""The libraries for all machines against the one for this machine, which the other tests judge: same scenes, same bits.

Needs a .fmu from `cargo xtask package --all-platforms` and, as FIVEBAR_FMU_HERE, one from `cargo xtask package`;
`cargo xtask test --platforms` makes both and runs this. Windows is wine here, and ARM is qemu.
"""

import os
import struct
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import fmpy
import pytest
from fmpy.model_description import ModelDescription, ScalarVariable

import scene
from conftest import REPOSITORY
from scene import Values

pytestmark = pytest.mark.platforms

SOURCES = REPOSITORY / "tests" / "platforms"

# Lines of a driver's script.
Script = list[str]


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine: its folder of binaries/, the ending of its libraries, its C compiler (the one that links the library under
    test), and what runs its programs here."""

    folder: str
    ending: str
    compiler: tuple[str, ...]
    runner: tuple[str, ...] = ()


ZIG = (sys.executable, "-m", "ziglang", "cc", "-target")
LINUX = (*ZIG, "x86_64-linux-gnu")
HERE = Machine("linux64", "so", LINUX)
SHIPPED = [
    Machine("linux64", "so", LINUX),
    Machine("win64", "dll", ("x86_64-w64-mingw32-gcc",), ("wine",)),
    Machine("aarch64-linux", "so", (*ZIG, "aarch64-linux-gnu"), ("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu")),
]


def compile_c(machine: Machine, source: str, output: Path, *options: str) -> None:
    """A C program or library for `machine`."""
    command = [*machine.compiler, "-std=c11", "-O1", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([*command, str(SOURCES / source), "-o", str(output), *options], check=True)


@pytest.fixture(scope="session")
def run(directory: str, model: ModelDescription, tmp_path_factory: pytest.TempPathFactory) -> Callable[[Machine, Script], list[str]]:
    """Carries out a script on a machine: the lines that its driver printed."""
    folder = tmp_path_factory.mktemp("platforms")
    environment = os.environ | {"WINEPREFIX": str(folder / "wine"), "WINEDEBUG": "-all", "WINEARCH": "win64"}
    here = fmpy.extract(os.environ["FIVEBAR_FMU_HERE"], unzipdir=str(folder / "here"))
    drivers: dict[str, Path] = {}

    def driver(machine: Machine) -> Path:
        if machine.folder not in drivers:
            program = folder / machine.folder / "driver.exe"
            program.parent.mkdir()
            compile_c(machine, "driver.c", program)
            if machine.ending == "dll":
                compile_c(machine, "bcryptprimitives.c", program.parent / "bcryptprimitives.dll", "-shared", "-ladvapi32")
            drivers[machine.folder] = program
        return drivers[machine.folder]

    def carry_out(machine: Machine, script: Script) -> list[str]:
        program = driver(machine)
        (program.parent / "script.txt").write_text("".join(f"{line}\n" for line in script))
        root = Path(here if machine is HERE else directory)
        library = root / "binaries" / machine.folder / f"{model.coSimulation.modelIdentifier}.{machine.ending}"
        command = [*machine.runner, str(program), str(library), model.guid, "script.txt"]
        done = subprocess.run(command, cwd=program.parent, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{machine.folder}: exit code {done.returncode}: {done.stderr[-2000:]}"
        return done.stdout.splitlines()

    return carry_out


def bits(value: float) -> str:
    """A number as the driver takes and prints it."""
    return struct.pack(">d", value).hex()


def setting(variable: ScalarVariable, value: float | int | bool) -> str:
    """The line that sets a variable."""
    match variable.type:
        case "Real":
            return f"real {variable.valueReference} {bits(value)}"
        case "Boolean":
            return f"boolean {variable.valueReference} {int(value)}"
        case _:
            return f"integer {variable.valueReference} {value}"


def motion(model: ModelDescription, values: Values, stop_time: float, size: float = 0.01) -> Script:
    """A run from 0 to `stop_time`, with every output read at every communication point."""
    variables = {v.name: v for v in model.modelVariables}
    outputs = [v for v in model.modelVariables if v.causality == "output"]
    reals = [str(v.valueReference) for v in outputs if v.type == "Real"]
    integers = [str(v.valueReference) for v in outputs if v.type != "Real"]
    readings = [f"reals {' '.join(reals)}", f"integers {' '.join(integers)}"]
    script = [setting(variables[name], value) for name, value in values.items()]
    script += [f"start {bits(stop_time)}", *readings]
    for i in range(round(stop_time / size)):
        script += [f"step {bits(i * size)} {bits(size)}", *readings]
    return script


def every_effect(model: ModelDescription) -> Values:
    """All effects at once, the contact where the tip touches it, and inputs that do work."""
    switches: Values = {v.name: True for v in model.modelVariables if v.name.endswith(".enabled")}
    return switches | {"init.theta[2]": 2.0944, "contact.offset": 0.1, "servo.theta[1]": 2.0, "servo.theta[2]": 0.7, "tip.fx": 0.2}


def methods(model: ModelDescription) -> list[int]:
    """The numbers of all methods."""
    (method,) = [v for v in model.modelVariables if v.name == "solver.method"]
    return [int(item.value) for item in method.declaredType.items]


def scripts(model: ModelDescription) -> dict[str, Script]:
    """What every machine has to carry out, by name."""
    fall = scene.read(REPOSITORY / "scenes" / "fall_90_120.json", model).variants[0].values
    named = {"fall": motion(model, fall, 5.0), "every effect": motion(model, every_effect(model), 5.0)}
    for method in methods(model):
        named[f"method {method}"] = motion(model, fall | {"solver.method": method}, 1.0)
    return named


def sentence_of_a_discard(model: ModelDescription) -> Script:
    """Steps too long for their method: discarded, with numbers in the sentence."""
    values: Values = {"solver.adaptive": False, "solver.stepSize": 0.05, "solver.maxIterations": 2, "tau[1]": 2.0}
    return motion(model, values, 1.0, 0.05)


def two_rounds(lines: list[str]) -> list[str]:
    """What one round printed; both must be equal, so that unloading and loading anew leaves nothing behind."""
    assert lines[0] == "round 1" and lines[-1] == "done", lines[-3:]
    middle = lines.index("round 2")
    assert lines[1:middle] == lines[middle + 1 : -1], "the second round differs from the first"
    return lines[1:middle]


@pytest.mark.parametrize("machine", SHIPPED, ids=lambda machine: machine.folder)
def test_same_bits_on_every_machine(run: Callable[[Machine, Script], list[str]], model: ModelDescription, machine: Machine) -> None:
    """The bound is zero: arithmetic, elementary functions and their order are the same everywhere."""
    for name, script in scripts(model).items():
        here = two_rounds(run(HERE, script))
        assert not [line for line in here if "status" in line], f"{name} does not run to its end"
        there = two_rounds(run(machine, script))
        assert there == here, f"{name}: {sum(a != b for a, b in zip(here, there, strict=False))} of {len(here)} lines differ"


@pytest.mark.parametrize("machine", SHIPPED, ids=lambda machine: machine.folder)
def test_same_sentences_on_every_machine(
    run: Callable[[Machine, Script], list[str]], model: ModelDescription, machine: Machine
) -> None:
    script = sentence_of_a_discard(model)
    here = two_rounds(run(HERE, script))
    assert "fmi2DoStep: status 2" in here, "no step was discarded"
    assert two_rounds(run(machine, script)) == here


def test_a_library_refuses_a_description_that_is_not_its_own(
    run: Callable[[Machine, Script], list[str]], model: ModelDescription
) -> None:
    """The driver notices what it should: without its GUID no library gives an instance."""
    guid, model.guid = model.guid, "{not this one}"
    try:
        with pytest.raises(AssertionError, match="gave null for the GUID"):
            run(HERE, [])
    finally:
        model.guid = guid
