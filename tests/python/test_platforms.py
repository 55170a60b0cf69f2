"""The libraries for all platforms against the library for this machine, which all other tests use: same scenes, same bits.

Needs a .fmu from `cargo xtask package --all-platforms` and, as FIVEBAR_FMU_HERE, one from `cargo xtask package`;
`cargo xtask test --platforms` makes both and runs this. Windows is emulated by wine and ARM by qemu; the library for macOS is not run.
"""

import os
import struct
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise, takewhile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.model_description import ModelDescription, ScalarVariable

from conftest import REPOSITORY, Unit
from fivebar.scene import communication_points, read
from fivebar.variables import Values
from instance import computed

pytestmark = pytest.mark.platforms

SOURCES = REPOSITORY / "tests" / "platforms"
# Seconds of each scene, and communication step: enough for fast passages, impacts and singularities under an emulator.
LONGEST, SIZE = 2.0, 0.01
# Duration of following, s: the assembly at the start is in doubt for some tenths of a second.
FOLLOWED = 1.2

# Time at which a state is stored for another machine, s.
STORED_AT = 0.5

# Lines of a driver's script; the driver's output for each script, by name, in each round.
Script = list[str]
Printed = dict[str, list[list[str]]]


@dataclass(frozen=True)
class Machine:
    """A machine: its folder of binaries/, file ending of libraries, C compiler (which links the tested library), program that runs its
    programs here, and number of times that a library is loaded and unloaded in one process. This number exceeds Windows' thread-local
    indexes (1,088), which no library may use up; it is smaller if each loading is translated again."""

    name: str
    folder: str
    ending: str
    compiler: tuple[str, ...]
    runner: tuple[str, ...] = ()
    loads: int = 1_500


ZIG = (sys.executable, "-m", "ziglang", "cc", "-target")
LINUX = (*ZIG, "x86_64-linux-gnu")
ARM = (*ZIG, "aarch64-linux-gnu")
HERE = Machine("here", "linux64", "so", LINUX)
SHIPPED = [
    Machine("linux64", "linux64", "so", LINUX),
    Machine("win64", "win64", "dll", ("x86_64-w64-mingw32-gcc",), ("wine",)),
    Machine("aarch64-linux", "aarch64-linux", "so", ARM, ("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"), loads=100),
]
on_every_machine = pytest.mark.parametrize("machine", SHIPPED, ids=lambda machine: machine.name)


class Bench:
    """Folders for the programs of all machines, each with its own driver."""

    def __init__(self, folder: Path, libraries: Callable[[Machine], Path], guid: str):
        self.folder, self.libraries, self.guid = folder, libraries, guid
        self.environment = os.environ | {"WINEPREFIX": str(folder / "wine"), "WINEDEBUG": "-all", "WINEARCH": "win64"}

    def place(self, machine: Machine) -> Path:
        """Folder of a machine, with its driver."""
        place = self.folder / machine.name
        if not place.exists():
            place.mkdir()
            command = [*machine.compiler, "-std=c11", "-O1", "-Wall", "-Wextra", "-Werror"]
            subprocess.run([*command, str(SOURCES / "driver.c"), "-o", str(place / "driver.exe")], check=True)
        return place

    def run(self, machine: Machine, scripts: dict[str, Script], rounds: int = 1) -> Printed:
        """Runs all scripts in one process, `rounds` times; each round loads the library before and unloads it afterwards."""
        place = self.place(machine)
        for name, script in scripts.items():
            (place / name).write_text("".join(f"{line}\n" for line in script))
        command = [
            *machine.runner,
            str(place / "driver.exe"),
            str(self.libraries(machine)),
            self.guid,
            str(rounds),
            *scripts,
        ]
        done = subprocess.run(command, cwd=place, env=self.environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{machine.name}: exit code {done.returncode}: {done.stderr[-2000:]}"
        printed: Printed = {name: [] for name in scripts}
        *lines, last = done.stdout.splitlines()
        assert last == "done", last
        for line in lines:
            if line.startswith("script "):
                current: list[str] = []
                printed[line.removeprefix("script ")].append(current)
            else:
                current.append(line)
        return printed


def bench_of(folder: Path, packed_here: str, directory: str, model: ModelDescription) -> Bench:
    """A bench of the tested libraries, extracted to `directory`, and the library that all other tests use."""
    here = fmpy.extract(packed_here, unzipdir=str(folder / "fmu"))

    def library(machine: Machine) -> Path:
        root = Path(here if machine is HERE else directory)
        return root / "binaries" / machine.folder / f"{model.coSimulation.modelIdentifier}.{machine.ending}"

    return Bench(folder, library, model.guid)


@pytest.fixture(scope="module")
def bench(directory: str, model: ModelDescription, tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """Bench of the plain unit."""
    return bench_of(tmp_path_factory.mktemp("platforms"), os.environ["FIVEBAR_FMU_HERE"], directory, model)


@pytest.fixture(scope="module")
def own_bench(own: Unit, tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """Bench of the unit of one's own."""
    return bench_of(tmp_path_factory.mktemp("platforms"), os.environ["FIVEBAR_OWN_HERE"], own.directory, own.model)


def bits(value: float) -> str:
    """A number in the driver's input and output format."""
    return struct.pack(">d", value).hex()


def setting(variable: ScalarVariable, value: float | bool) -> str:
    """The line that sets a variable."""
    match variable.type:
        case "Real":
            return f"real {variable.valueReference} {bits(value)}"
        case "Boolean":
            return f"boolean {variable.valueReference} {int(value)}"
        case _:
            return f"integer {variable.valueReference} {value}"


def motion(
    model: ModelDescription,
    values: Values,
    stop_time: float,
    size: float = SIZE,
    inputs: dict[str, np.ndarray] | None = None,
) -> Script:
    """A run from 0 to `stop_time` that reads all computed variables at every communication point, `size` seconds apart."""
    variables = {v.name: v for v in model.modelVariables}
    readings = read_all(model)
    points = communication_points(stop_time, size)
    script = [setting(variables[name], value) for name, value in values.items()]
    script += [f"start {bits(stop_time)}", *readings]
    for i, (now, then) in enumerate(pairwise(points)):
        script += [setting(variables[name], course[i]) for name, course in (inputs or {}).items()]
        script += [f"step {bits(now)} {bits(then - now)}", *readings]
    return script


def read_all(model: ModelDescription) -> Script:
    """Reads all computed variables, and the derivative of every Real by the first torque."""
    reals = [str(v.valueReference) for v in computed(model) if v.type == "Real"]
    integers = [str(v.valueReference) for v in computed(model) if v.type != "Real"]
    (torque,) = [v.valueReference for v in model.modelVariables if v.name == "tau[1]"]
    return [f"reals {' '.join(reals)}", f"integers {' '.join(integers)}", f"slopes {torque} {' '.join(reals)}"]


def every_effect(model: ModelDescription) -> Values:
    """All effects at once, with the plane at the tip and inputs that do work."""
    switches: Values = {v.name: True for v in model.modelVariables if v.name.endswith(".enabled")}
    return switches | {
        "init.theta[2]": 2.0944,
        "contact.offset": 0.1,
        "servo.theta[1]": 2.0,
        "servo.theta[2]": 0.7,
        "tip.fx": 0.2,
    }


def methods(model: ModelDescription) -> dict[str, int]:
    """Methods with their numbers."""
    (method,) = [v for v in model.modelVariables if v.name == "solver.method"]
    return {item.name: int(item.value) for item in method.declaredType.items}


def followed(bench: Bench, model: ModelDescription, fall: Values) -> dict[str, Script]:
    """The fall through singularities, followed by every method with encoders of 16 bits, from a start that is 0.01 rad off. After 1 s samples
    stop, and the forecast by sigma points continues."""
    references = {v.name: v.valueReference for v in model.modelVariables}
    motors, count = [references[f"theta[{i}]"] for i in (1, 2)], 2 * np.pi / 2**16
    reading = [
        line if not line.startswith("reals") else f"reals {motors[0]} {motors[1]}"
        for line in motion(model, fall, FOLLOWED)
    ]
    (lines,) = bench.run(
        HERE, {"machine": [line for line in reading if line.startswith(("real", "boolean", "integer ", "st"))]}
    )["machine"]
    angles = np.array(
        [
            [struct.unpack(">d", bytes.fromhex(bits))[0] for bits in line.split()[1:]]
            for line in lines
            if "reals" in line
        ]
    )
    points = communication_points(FOLLOWED, SIZE)
    heard = np.minimum(np.arange(len(points)), round(1.0 / SIZE))
    inputs = {f"measured.theta[{i + 1}]": np.round(angles[heard, i] / count) * count for i in (0, 1)}
    inputs |= {f"measured.time[{i}]": np.asarray(points)[heard] for i in (1, 2)}
    twin: Values = {"estimator.enabled": True, "estimator.forecast": 2, "estimator.maxDelay": 0.02}
    twin |= {f"estimator.quantum[{i}]": count for i in (1, 2)} | {"init.theta[2]": fall["init.theta[2]"] + 0.01}
    return {
        f"followed_{name}": motion(model, fall | twin | {"solver.method": number}, FOLLOWED, inputs=inputs)
        for name, number in methods(model).items()
    }


@pytest.fixture(scope="module")
def motions(bench: Bench, scenes: Path, model: ModelDescription) -> dict[str, Script]:
    """Scripts that every machine must complete: the scenes, every method, every effect at once, and following."""
    named = {}
    for path in sorted(scenes.glob("*.json")):
        scene = read(path).coarser(SIZE, LONGEST)
        named[scene.name] = motion(model, scene.variants[0].values, scene.stop_time, inputs=scene.signals)
    fall = read(scenes / "fall_90_120.json").variants[0].values
    for name, number in methods(model).items():
        named[f"method_{name}"] = motion(model, fall | {"solver.method": number}, 1.0)
    named["every_effect"] = motion(model, every_effect(model), LONGEST)
    return named | followed(bench, model, fall)


def sentence_of_a_discard(model: ModelDescription) -> Script:
    """Steps too long for their method: discarded, with numbers in the message."""
    values: Values = {"solver.adaptive": False, "solver.stepSize": 0.05, "solver.maxIterations": 2, "tau[1]": 2.0}
    return motion(model, values, 1.0, 0.05)


@pytest.fixture(scope="module")
def expected(bench: Bench, motions: dict[str, Script]) -> Printed:
    """Output of this machine's library for the motions."""
    printed = bench.run(HERE, motions)
    for name, (lines,) in printed.items():
        # Directional derivatives are refused while friction holds the tip, or everything.
        refused = "fmi2GetDirectionalDerivative: status 3" if "stick" in name else None
        assert not [line for line in lines if ": status " in line and line != refused], (
            f"{name} does not run to its end"
        )
    return printed


@on_every_machine
def test_same_bits_on_every_machine(
    bench: Bench, motions: dict[str, Script], expected: Printed, machine: Machine
) -> None:
    """The bound is zero: arithmetic, elementary functions and their order are the same everywhere."""
    for name, (there,) in bench.run(machine, motions).items():
        (here,) = expected[name]
        assert there == here, (
            f"{name}: {sum(a != b for a, b in zip(here, there, strict=False))} of {len(here)} lines differ"
        )


def test_machines_are_followed(model: ModelDescription, expected: Printed) -> None:
    """The scripts of following do follow, and coast at the end, so that the compared bits are meaningful."""
    names = [v.name for v in computed(model) if v.type != "Real"]
    (status,) = [v for v in model.modelVariables if v.name == "estimated.status"]
    items = {int(item.value): item.name for item in status.declaredType.items}
    for name in methods(model):
        (lines,) = expected[f"followed_{name}"]
        statuses = [
            items[int(line.split()[1 + names.index(status.name)])] for line in lines if line.startswith("integers")
        ]
        assert statuses.count("following") > 50 and statuses[-1] == "coasting", name


@on_every_machine
def test_same_sentences_on_every_machine(bench: Bench, model: ModelDescription, machine: Machine) -> None:
    scripts = {"discard": sentence_of_a_discard(model)}
    here = bench.run(HERE, scripts)
    assert "fmi2DoStep: status 2" in here["discard"][0], "no step was discarded"
    assert bench.run(machine, scripts) == here


@on_every_machine
def test_a_motion_continues_on_another_machine(bench: Bench, model: ModelDescription, machine: Machine) -> None:
    """A state stored here has the same bytes there and continues with the same bits."""
    scripts = {name: every_effect(model) | {"solver.method": number} for name, number in methods(model).items()}
    check_going_on(bench, machine, {name: motion(model, values, 1.0) for name, values in scripts.items()})


@on_every_machine
def test_a_unit_of_one_s_own_has_the_same_bits_on_every_machine(own_bench: Bench, own: Unit, machine: Machine) -> None:
    """No value is set; runs that continue from a stored state have the same bits, too."""
    scripts = {"own": motion(own.model, {}, LONGEST)}
    here = own_bench.run(HERE, scripts)
    assert not [line for line in here["own"][0] if "status" in line], "it does not run to its end"
    assert own_bench.run(machine, scripts) == here
    check_going_on(own_bench, machine, scripts)


def check_going_on(bench: Bench, machine: Machine, scripts: dict[str, Script]) -> None:
    """Stores a state on the way, here and there, with the same bytes; the other machine continues from the bytes stored here."""
    storing, going_on = {}, {}
    for name, script in scripts.items():
        first = next(i for i, line in enumerate(script) if line.startswith(f"step {bits(STORED_AT)} "))
        start = next(i for i, line in enumerate(script) if line.startswith("start "))
        storing[name] = [*script[:first], f"store {name}.state", *script[first:]]
        going_on[name] = [*script[: start + 1], f"restore {name}.state", *script[first:]]
    uninterrupted = bench.run(HERE, storing)
    bench.run(machine, storing)
    for state in (f"{name}.state" for name in storing):
        here, there = (bench.place(where) / state for where in (HERE, machine))
        assert there.read_bytes() == here.read_bytes(), state
    for name, (lines,) in bench.run(machine, going_on).items():
        # The driver's lines about its start come first.
        said = list(takewhile(lambda line: line.startswith("log "), lines))
        rest = lines[len(said) :]
        assert any(" ready: " in line for line in said)
        assert len(rest) > 100 and rest == uninterrupted[name][0][-len(rest) :], name


@on_every_machine
def test_loading_and_unloading_uses_nothing_up(bench: Bench, model: ModelDescription, machine: Machine) -> None:
    """After each round the driver checks that the library is gone."""
    script = motion(model, {}, SIZE)
    first, *others = bench.run(machine, {"once": script}, machine.loads)["once"]
    assert len(others) == machine.loads - 1 and all(lines == first for lines in others)


def test_a_library_refuses_a_description_that_is_not_its_own(bench: Bench) -> None:
    """The driver detects failure: with a wrong GUID no library gives an instance."""
    other = Bench(bench.folder, bench.libraries, "{not this one}")
    with pytest.raises(AssertionError, match="gave null for the GUID"):
        other.run(HERE, {"nothing": []})
