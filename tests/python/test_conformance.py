"""The programs of tests/conformance/ on the library in the .fmu: masters in C, compiled with the standard's own headers."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest
from fmpy.model_description import ModelDescription, ScalarVariable

from conftest import REPOSITORY, Unit

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the programs look at /proc and use dlopen")

SOURCES = REPOSITORY / "tests" / "conformance"
HEADERS = Path(fmpy.__file__).parent / "c-code"
SHARED = ("master.c", "scenes.c")
WALK = ("walk_life.c", "walk_values.c", "walk_states.c", "walk_exchange.c")

MEMCHECK = (
    "valgrind",
    "--quiet",
    "--error-exitcode=9",
    "--leak-check=full",
    "--errors-for-leak-kinds=definite,indirect,possible",
)
HELGRIND = ("valgrind", "--quiet", "--error-exitcode=9", "--tool=helgrind")

# Runs a program with arguments after library, GUID and table; returns the printed line.
Run = Callable[..., str]


def row(variable: ScalarVariable) -> str:
    """Encodes a variable for master.c: reference, type, role, min, max, start, name; reals in hexadecimal."""
    kind = {"Real": "R", "Boolean": "B"}.get(variable.type, "I")
    parameter = "t" if variable.variability == "tunable" else "f"
    taken = "s" if variable.variability == "discrete" else "i"
    role = {"input": taken, "parameter": parameter, "output": "o", "local": "l"}[variable.causality]
    if variable.type == "Enumeration":
        items = [float(item.value) for item in variable.declaredType.items]
        low, high = min(items), max(items)
    else:
        widest = 2.0**31 - 1 if variable.type == "Integer" else float("inf")
        low, high = float(variable.min or -widest), float(variable.max or widest)
    start = {"true": 1.0, "false": 0.0, None: float("nan")}.get(variable.start)
    start = float(variable.start) if start is None else start
    return f"{variable.valueReference} {kind} {role} {low.hex()} {high.hex()} {start.hex()} {variable.name}"


def runner(directory: str, model: ModelDescription, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Compiles a program at its first use and runs it in an empty folder, which must stay empty."""
    folder = tmp_path_factory.mktemp("conformance")
    table = folder / "variables.txt"
    # A derivative shares its value reference with another variable.
    rows = {v.valueReference: row(v) for v in reversed(model.modelVariables)}
    table.write_text("".join(f"{text}\n" for text in rows.values()))
    shipped = Path(directory) / "binaries" / fmpy.platform / f"{model.coSimulation.modelIdentifier}.so"

    def carry_out(
        name: str, *arguments: object, under: tuple[str, ...] = (), library: Path = shipped, **environment: str
    ) -> str:
        program = folder / name
        if not program.exists():
            sources = [str(SOURCES / source) for source in (f"{name}.c", *SHARED, *(WALK if name == "walk" else ()))]
            options = [
                "-std=c11",
                "-D_GNU_SOURCE",
                "-O1",
                "-g",
                "-Wall",
                "-Wextra",
                "-Werror",
                "-isystem",
                str(HEADERS),
            ]
            subprocess.run(["cc", *options, *sources, "-o", str(program), "-ldl", "-lm", "-pthread"], check=True)
        here = tmp_path_factory.mktemp(name)
        command = [*under, str(program), str(library), model.guid, str(table), *map(str, arguments)]
        done = subprocess.run(
            command, cwd=here, env=os.environ | environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{name}: exit code {done.returncode}: {done.stderr[-4000:]}"
        assert library != shipped or done.stderr == "", "something was written to standard error"
        assert list(here.iterdir()) == [], "something was written to the working directory"
        lines = done.stdout.splitlines()
        assert len(lines) == 1, lines
        print(lines[0])
        return lines[0]

    return carry_out


@pytest.fixture(scope="session")
def run(directory: str, model: ModelDescription, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Runs programs on the plain unit."""
    return runner(directory, model, tmp_path_factory)


@pytest.fixture(scope="session")
def run_own(own: Unit, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Runs programs on the unit of one's own."""
    return runner(own.directory, own.model, tmp_path_factory)


# Calls, seed and magnitude of values as a power of ten; `cargo xtask walk` sets a single walk of its own. A walk must make each call in each
# state. Steps seldom fail, so that walks of 50,000 calls may miss a call in "step failed".
OWN_WALK = os.environ.get("FIVEBAR_WALK")
LONG = pytest.mark.nightly
WALKS = [
    (100_000, 1, 12),
    (100_000, 6, 308),
    *(pytest.param(250_000, *more, marks=LONG) for more in ((1, 12), (5, 12), (6, 308))),
]


@pytest.mark.parametrize(("calls", "seed", "largest"), [tuple(OWN_WALK.split())] if OWN_WALK else WALKS)
def test_random_walk(run: Run, calls: object, seed: object, largest: object) -> None:
    assert "steps discarded" in run("walk", calls, seed, largest)


@pytest.mark.parametrize("calls", [100_000, pytest.param(250_000, marks=LONG)])
def test_walk_on_a_unit_of_one_s_own(run_own: Run, calls: int) -> None:
    assert "steps discarded" in run_own("walk", calls, 3, 12)


@pytest.mark.full
@pytest.mark.parametrize("calls", [10_000, pytest.param(250_000, marks=LONG)])
def test_random_walk_under_valgrind(run: Run, calls: int) -> None:
    # Values up to 1e2: larger ones need many sub-steps and take fifty times as long.
    assert "steps discarded" in run("walk", calls, 4, 2, under=MEMCHECK)


def test_load_run_free_without_growth(run: Run) -> None:
    # Without caches per thread the C library counts used memory to the byte.
    assert "1500 cycles" in run("cycles", 1500, GLIBC_TUNABLES="glibc.malloc.tcache_count=0")


def test_threads_have_the_same_bits(run: Run) -> None:
    assert "the same bits" in run("threads", 4, 200)


@pytest.mark.full
def test_threads_under_helgrind(run: Run) -> None:
    assert "the same bits" in run("threads", 2, 4, under=HELGRIND)


def test_no_allocation_in_a_run(run: Run) -> None:
    assert "no allocation" in run("allocation", 200)


@pytest.mark.parametrize("runs", ["run", "run_own"])
def test_bytes_go_on_in_another_process(runs: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    run: Run = request.getfixturevalue(runs)
    file = tmp_path / "states"
    run("bytes", "write", file)
    assert "the same bits" in run("bytes", "read", file)


@pytest.mark.full
def test_surroundings_stay(run: Run, tmp_path: Path) -> None:
    locale = "de_DE.UTF-8"
    subprocess.run(["localedef", "-i", "de_DE", "-f", "UTF-8", str(tmp_path / locale)], check=True)
    line = run("surroundings", locale, LOCPATH=str(tmp_path))
    # Round-off of 25 steps, amplified by the fall; a function that fails under another rounding mode would be obvious.
    assert float(line.split()[-2]) < 1e-8


@pytest.mark.full
def test_a_forced_panic_is_fatal(run: Run) -> None:
    library = Path(os.environ["FIVEBAR_PANICKING"])
    assert "a panic is fmi2Fatal" in run("panic", library=library)
