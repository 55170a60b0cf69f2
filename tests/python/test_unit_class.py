"""`fivebar.Unit`: names, values, steps, states, derivatives, messages and errors of a live unit."""

import gc
import logging
import math
import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from fmpy.model_description import ModelDescription

import fivebar
from fivebar import FiveBarError, StepFailed, Unit, UnitError, instance, library
from instance import Instance

FALL = {"init.theta[2]": 2.0943951023931953}
HOPELESS = {"tau[1]": 50.0, "solver.method": "i3alpPrinted", "solver.maxIterations": 1}
"""Settings with which a step fails: one iteration of the printed method is not enough."""


@pytest.fixture(autouse=True)
def packed(fmu: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The unit under test is the shipped one."""
    monkeypatch.setenv("FIVEBAR_FMU", str(fmu))
    yield


def bits(unit: Unit) -> list[float]:
    """All computed variables, as bits."""
    return unit.numbers(tuple(v.name for v in unit.variables.values() if v.causality in ("output", "local")))


def test_pickles_of_another_unit_are_refused(fmu: Path, tmp_path: Path) -> None:
    """A pickled library is its file or the shipped one; pickled blocks of variables keep value references, so the unit must match."""
    moved = tmp_path / "moved.fmu"
    moved.write_bytes(fmu.read_bytes())
    made = library.Library(moved)
    block = pickle.loads(pickle.dumps(made.blocks(("tau[1]", "tau[2]"))[0]))
    stored = pickle.dumps(made)
    made.close()
    moved.unlink()
    again = pickle.loads(stored)
    assert again.guid == made.guid
    with Unit.of(again) as unit:
        unit.reset(**{"tau[2]": 0.5})
        assert list(unit.read(block)) == [0.0, 0.5]
    made.model.guid = "{another}"
    with pytest.raises(
        FiveBarError, match=r"is the unit \{.*\}, but the pickled object is of the unit \{another\} at .*moved.fmu$"
    ):
        pickle.loads(pickle.dumps(made))


def test_it_is_the_unit_to_the_bit(model: ModelDescription, directory: str) -> None:
    raw = Instance(model, directory).initialise(FALL)
    with Unit(**FALL) as unit:
        for i in range(200):
            raw.slave.doStep(i * 1e-3, 1e-3)
            unit.step(1e-3)
        assert unit.get("tip.x", "tip.y", "energy.error") == tuple(
            raw.get(n) for n in ("tip.x", "tip.y", "energy.error")
        )
        assert unit.time == pytest.approx(0.2, abs=1e-12)
    raw.slave.freeInstance()


def test_a_scene_and_values_are_start_values() -> None:
    """Values replace the scene's before initialisation; enumerations by name or number; arrays as a whole."""
    with Unit("pick_and_place", **{"payload.mass": 0.1, "solver.method": "automatic"}) as unit:
        assert unit["payload.mass"] == 0.1 and unit["solver.method"] == "automatic" and unit["servo.enabled"] is True
        # A signal of the scene has its first value.
        first = fivebar.run("pick_and_place")["servo.theta[1]"][0]
        assert unit["servo.theta[1]"] == first
    with Unit(
        **{"solver.method": 6, "viscous.enabled": np.bool_(True), "viscous.b": np.full(5, 2e-3, np.float32)}
    ) as unit:
        assert unit["solver.method"] == "automatic" and unit["viscous.b"].shape == (5,)
    # As in `run`; changed values may choose the method.
    with Unit("swing") as unit:
        assert unit["solver.method"] == "automatic"
        for time in (run := fivebar.run("swing", stop_time=0.1)).time[1:].tolist():
            unit.step_to(time)
        assert unit["theta"].tolist() == [run["theta[1]"][-1], run["theta[2]"][-1]]
        unit.reset(**{"solver.adaptive": False})
        assert unit["solver.method"] == "i3alp"
    with Unit() as unit:
        assert unit["solver.method"] == "i3alp"
    with Unit(str(Path(__file__).resolve().parents[2] / "scenes" / "swing.json")) as unit:
        assert unit.time == 0.0


def test_reading_by_several_names_and_arrays() -> None:
    with Unit(**FALL) as unit:
        x, theta, kind, count, off = unit.get("tip.x", "theta", "singular.type", "solver.steps", "servo.enabled")
        assert isinstance(x, float) and theta.shape == (2,) and theta[1] == FALL["init.theta[2]"]
        assert (kind, count, off) == ("none", 0, False) and type(count) is int and type(off) is bool
        assert unit["link.mass"].tolist() == [unit[f"link[{i}].mass"] for i in (1, 2, 3, 4)]
        assert unit.units["link.mass"] == unit.units["link[1].mass"] == "kg"
        unit["tau"] = np.array([0.01, -0.02])
        assert unit.get("tau[1]", "tau[2]") == (0.01, -0.02)


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("tipp.x", 0, "there is no variable 'tipp.x'; did you mean 'tip"),
        ("tau", [1.0], r"'tau' has 2 elements, tau\[1\] to tau\[2\], but is given 1"),
        ("tau", 1.0, r"'tau' has 2 elements, tau\[1\] to tau\[2\], but is given one"),
        ("tau[1]", "much", "must be a number in N.m"),
        ("tau[1]", True, "must be a number in N.m"),
        ("solver.method", "euler", "'solver.method' must be one of i3alp, "),
        ("viscous.enabled", 1, "'viscous.enabled' must be true or false, not 1"),
    ],
)
def test_what_has_no_such_name_or_type(name: str, value: object, sentence: str) -> None:
    with Unit() as unit, pytest.raises(FiveBarError, match=sentence):
        unit[name] = value
    with pytest.raises(FiveBarError, match=sentence):
        Unit(**{name: value})


@pytest.mark.parametrize(
    ("name", "value", "start"),
    [("link[1].mass", -1.0, True), ("tau[1]", math.nan, True), ("link[1].mass", 0.02, False), ("tip.x", 0.1, True)],
)
def test_refusals_are_the_units_own_sentences(name: str, value: float, start: bool) -> None:
    """Values out of bounds, not a number, fixed after the start, or computed are refused; nothing changes."""
    with Unit() as unit:
        before = bits(unit)
        with pytest.raises(UnitError, match=rf"^fmi2SetReal: .*{name.replace('[', '.').replace(']', '.')}") as refused:
            unit[name] = value
        assert unit.log[-1].text == str(refused.value) and bits(unit) == before
    if start:
        with pytest.raises(UnitError, match="^fmi2SetReal: "):
            Unit(**{name: value})


def test_a_start_that_is_refused_can_be_mended() -> None:
    with Unit() as unit:
        with pytest.raises(UnitError, match="^fmi2ExitInitializationMode: "):
            unit.reset(**{"base.distance": 5.0})
        unit.reset(2.0, **FALL)
        unit.step(0.01)
        assert unit.time == 2.01


def test_a_step_that_cannot_be_done_leaves_the_unit_as_it_was() -> None:
    with Unit(**HOPELESS) as unit:
        before = bits(unit)
        with pytest.raises(StepFailed, match="the state at 0.0 s is unchanged") as failed:
            unit.step(1e-3)
        assert isinstance(failed.value, FiveBarError) and failed.value.result is None
        assert bits(unit) == before and unit.time == 0.0
        with pytest.raises(UnitError, match="communicationStepSize") as refused:
            unit.step(-1.0)
        assert not isinstance(refused.value, StepFailed)


def test_restored_states_continue_to_the_same_bits() -> None:
    """States as handles, many at once, also into another unit; and as bytes, which outlive the unit."""
    with Unit(**FALL) as unit, Unit() as other:
        states = []
        for _ in range(3):
            unit.step(0.1)
            states.append((unit.state(), bits(unit), unit.time))
        for state, there, time in reversed(states):
            other.restore(state)
            assert bits(other) == there and other.time == state.time == time
        content = states[1][0].to_bytes()
        unit.restore(states[1][0])
        unit.step(0.05)
        end = bits(unit)
    with Unit() as third:
        third.restore(content)
        assert third.time == states[1][2]
        third.step(0.05)
        assert bits(third) == end
        with pytest.raises(FiveBarError, match="is closed"):
            third.restore(states[0][0])
        with pytest.raises(UnitError, match="^fmi2DeSerializeFMUstate: "):
            third.restore(content[:-1] + bytes([content[-1] ^ 1]))
        assert bits(third) == end
    with pytest.raises(FiveBarError, match="is closed"):
        states[0][0].to_bytes()


def test_states_that_nobody_holds_are_reused() -> None:
    with Unit() as unit:
        for _ in range(100):
            kept = unit.state(), unit.state()
        assert len(unit._handles) <= 4 and kept
        for _ in range(100):
            unit.restore(kept[0].to_bytes())
        assert len(unit._handles) <= 5


def test_bytes_go_on_in_another_process(tmp_path: Path) -> None:
    code = "import sys, fivebar; u = fivebar.Unit(); u.restore(open(sys.argv[1], 'rb').read()); u.step(0.1); print(repr((u.time, u['tip.x'])))"
    with Unit(**FALL) as unit:
        unit.step(0.1)
        (tmp_path / "state").write_bytes(unit.state().to_bytes())
        unit.step(0.1)
        command = [sys.executable, "-c", code, str(tmp_path / "state")]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert done.stdout == f"{(unit.time, unit['tip.x'])!r}\n"


def test_derivatives_are_differences() -> None:
    """Derivatives of accelerations by torques and rates equal the matrix of central differences."""
    start, step = {"init.theta": (1.2, 2.0), "init.omega": (0.5, 0.0)}, 1e-5

    def accelerations(changes: dict[str, float]) -> np.ndarray:
        with Unit(**start, **changes) as unit:
            return np.append(unit["alpha"], unit["tip.ax"])

    with Unit(**start) as unit:
        found = unit.derivative(("alpha", "tip.ax"), ["tau[1]", "tau[2]"])
        assert found.shape == (3, 2)
        assert np.array_equal(unit.derivative("alpha", "tau"), found[:2])
    for j in (1, 2):
        above, below = (accelerations({f"tau[{j}]": sign * step}) for sign in (1, -1))
        # Errors of differences: step² times third derivatives of some 1e3, and ε·1e2/step.
        assert found[:, j - 1] == pytest.approx((above - below) / (2 * step), rel=1e-6, abs=1e-6)


def test_messages_are_kept_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG, "fivebar.unit"), Unit() as unit:
        for _ in range(instance.MESSAGES + 1):
            with pytest.raises(UnitError):
                unit["tau[1]"] = math.nan
        assert len(unit.log) == instance.MESSAGES and str(unit.log[-1]).startswith("Error: fmi2SetReal: tau[1] = NaN")
        unit.log.clear()
        assert caplog.records[-1].levelno == logging.DEBUG and caplog.records[-1].getMessage().startswith("fmi2SetReal")


def test_a_unit_is_made_of_an_fmu_by_its_path(fmu: Path, tmp_path: Path) -> None:
    for path in (fmu, str(fmu)):
        with Unit.of(path) as unit:
            unit.reset(**{"tau[2]": 0.5})
            assert unit["tau[2]"] == 0.5
    (tmp_path / "a.fmu").write_text("no archive")
    with ZipFile(tmp_path / "b.fmu", "w") as archive:
        archive.writestr("a.txt", "no description")
    for wrong, sentence in (
        (tmp_path / "a.fmu", "a.fmu is not an .fmu: a ZIP archive with a modelDescription.xml is needed"),
        (tmp_path / "b.fmu", "b.fmu is not an .fmu: a ZIP archive with a modelDescription.xml is needed"),
        (tmp_path / "c.fmu", "there is no .fmu at .*c.fmu"),
        (3, "'library' must be the path of an .fmu or a Library, not 3"),
    ):
        with pytest.raises(FiveBarError, match=f"{sentence}$"):
            Unit.of(wrong)  # type: ignore[arg-type]


def test_numbers_are_read_by_one_name_or_any_sequence_of_names() -> None:
    with Unit() as unit:
        assert unit.numbers("tip.x") == unit.numbers(["tip.x"]) == unit.numbers(("tip.x",)) == [unit["tip.x"]]
        assert unit.floats("tip.x") == unit.floats(iter(["tip.x"])) == {"tip.x": unit["tip.x"]}
        for read in (unit.numbers, unit.floats):
            with pytest.raises(FiveBarError, match=r"^'names' must be a name or a list of names, not \[3\]$"):
                read([3])  # type: ignore[list-item]


def test_a_closed_unit_says_so() -> None:
    unit = Unit()
    unit.close()
    unit.close()
    for call in (lambda: unit.step(1e-3), lambda: unit["tip.x"], unit.state, unit.reset):
        with pytest.raises(FiveBarError, match="^the unit is closed$"):
            call()


def test_units_that_are_dropped_are_freed() -> None:
    used = library.shared().open
    before = len(used)
    unit = Unit()
    state = unit.state()
    assert len(used) == before + 1
    del unit, state
    gc.collect()
    assert len(used) == before


def test_the_files_go_with_the_process(tmp_path: Path) -> None:
    code = (
        "import fivebar; u = fivebar.Unit(); v = fivebar.Unit('swing'); print(u.library.directory); raise SystemExit(3)"
    )
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 3 and done.stdout.startswith(str(tmp_path)) and done.stderr == ""
    assert list(tmp_path.iterdir()) == []


def test_threads_give_the_same_bits_as_alone() -> None:
    """Several units side by side, and one unit that serialises calls."""

    def run(angle: float, found: dict[float, list[float]]) -> None:
        with Unit(**{"init.theta[2]": angle}) as unit:
            for _ in range(200):
                unit.step(1e-3)
                unit.get("tip.x", "tip.y")
            found[angle] = bits(unit)

    angles = [1.9, 2.0, 2.1, 2.2]
    alone: dict[float, list[float]] = {}
    together: dict[float, list[float]] = {}
    for angle in angles:
        run(angle, alone)
    threads = [threading.Thread(target=run, args=(angle, together)) for angle in angles]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert together == alone

    with Unit(**FALL) as unit:
        threads = [threading.Thread(target=lambda: [unit.step(1e-3) for _ in range(50)]) for _ in range(4)]
        for each in threads:
            each.start()
        for each in threads:
            each.join()
        assert unit.get("solver.steps") == 200


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this platform")
def test_both_sides_of_a_fork_continue() -> None:
    """Each side has a copy and computes the same bits; the child leaves the files to its parent and may make new units."""

    def child(sent: "multiprocessing.connection.Connection") -> None:
        unit.step(0.1)
        with Unit("swing") as own:
            own.step(0.01)
        sent.send(bits(unit))
        unit.close()
        sys.exit(0)

    with Unit(**FALL) as unit:
        receiving, sending = multiprocessing.Pipe()
        process = multiprocessing.get_context("fork").Process(target=child, args=(sending,))
        process.start()
        # If the child ends early, `recv` fails instead of waiting.
        sending.close()
        there = receiving.recv()
        process.join()
        unit.step(0.1)
        assert process.exitcode == 0 and there == bits(unit)
        assert Path(unit.library.directory).is_dir()


def test_values_of_a_reset_replace_those_of_the_start() -> None:
    with Unit(**{"init.theta": (1.3, 2.0), "init.theta[1]": 1.2}) as unit:
        unit.reset(**{"init.theta": (1.4, 2.1)})
        assert unit["theta"].tolist() == [1.4, 2.1]


@pytest.mark.parametrize("given", [{2.0, 1.0}, {1.0: "a", 2.0: "b"}, "12"])
def test_arrays_are_sequences(given: object) -> None:
    with Unit() as unit, pytest.raises(FiveBarError, match="'tau' has 2 elements"):
        unit["tau"] = given
    with Unit() as unit, pytest.raises(FiveBarError, match=r"tau\[1\]"):
        unit["tau[1]"] = np.array([1.0, 2.0])


def test_a_unit_is_described_and_has_its_names() -> None:
    with Unit("swing") as unit, Unit() as bare:
        unit.step(0.25)
        assert (repr(unit), repr(bare)) == ("<fivebar.Unit of swing, at 0.25 s>", "<fivebar.Unit, at 0 s>")
        assert "tip.x" in unit and "tau" in unit and "tip" not in unit and 0 not in unit
    assert repr(unit) == "<fivebar.Unit of swing, closed>"


def test_an_assignment_reaches_the_unit_or_is_refused() -> None:
    with Unit() as unit:
        with pytest.raises(ValueError, match="read-only"):
            unit["tau"][0] = 1.0
        with pytest.raises(AttributeError, match="'tau'"):
            unit.tau = (3.0, 3.0)  # type: ignore[attr-defined]
        assert unit["tau"].tolist() == [0.0, 0.0]
