"""Wrong types and values in every public function: one sentence that names the argument and its value."""

import pickle
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import fivebar
from fivebar import FiveBarError, Machine, Result, Scene, Unit

FALL = "fall_90_120"
TOO_LARGE = 10**400
"""An int larger than any float."""


@pytest.fixture(autouse=True)
def packed(fmu: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The unit under test is the shipped one."""
    monkeypatch.setenv("FIVEBAR_FMU", str(fmu))


@pytest.fixture(scope="module")
def unit(fmu: Path) -> Iterator[Unit]:
    """One unit for all calls: each is refused."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FIVEBAR_FMU", str(fmu))
        with Unit() as unit:
            yield unit


@pytest.fixture(scope="module")
def result(fmu: Path) -> Result:
    """A short run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FIVEBAR_FMU", str(fmu))
        return fivebar.run(FALL, stop_time=0.01)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda u: u.get(None), "a variable is named by a text, not by null"),
        (lambda u: u[["theta[1]"]], r'a variable is named by a text, not by \["theta\[1\]"\]'),
        (lambda u: u.set(1, 0.0), r"'values' must be a dict from names to values, not \{\"1\":0.0\}"),
        (lambda u: u.update("x"), "'values' must be a dict from names to values, not \"x\""),
        (
            lambda u: u.update({object: 1}),
            r"'values' must be a dict from names to values, not \"\{<class 'object'>: 1\}\"",
        ),
        (lambda u: u.set("tau[1]", TOO_LARGE), r"'tau\[1\]' must be a number in N.m"),
        (lambda u: u.ramp(None), "'values' must be a dict from names to values, not null"),
        (lambda u: u.ramp({"tau[1]": "a"}), r"'tau\[1\]' must be a number in N.m"),
        (lambda u: u.ramp({"tau": 1.0}), r"'tau' has 2 elements, tau\[1\] to tau\[2\], but is given one"),
        (lambda u: u.ramp({"solver.method": 1}), "'solver.method' is not a Real input: only Real inputs have rates"),
        (lambda u: u.ramp({"tip.x": 1.0}), "'tip.x' is not a Real input: only Real inputs have rates"),
        (lambda u: u.derivative(None, "tau"), "'unknowns' must be a name or a list of names, not null"),
        (lambda u: u.derivative("alpha", ["tau", 1]), r"'knowns' must be a name or a list of names, not \[\"tau\",1\]"),
        (lambda u: u.step(None), "'h' must be a number in s, not null"),
        (lambda u: u.step_to("x"), "'time' must be a number in s, not \"x\""),
        (lambda u: u.reset(True), "'time' must be a number in s, not true"),
        (lambda u: u.restore(3), "'state' must be a State or its bytes, not 3"),
        (lambda u: u.restore(u.state(), "x"), "'time' must be a number in s, not \"x\""),
    ],
)
def test_a_unit(unit: Unit, call: Callable[[Any], Any], sentence: str) -> None:
    with pytest.raises(FiveBarError, match=f"^{sentence}"):
        call(unit)
    assert unit.time == 0.0


def test_a_unit_is_not_sent_to_another_process(unit: Unit) -> None:
    for each, sentence in (
        (unit, "a live unit cannot be pickled: send its `state().to_bytes()`, and `restore` them in a new unit"),
        (unit.state(), "a state cannot be pickled: send its `to_bytes()`, and `restore` them in another unit"),
    ):
        with pytest.raises(TypeError, match=f"^{re.escape(sentence)}$"):
            pickle.dumps(each)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"outputs": [1]}, r"'outputs' must be a name or a list of names, not \[1\]"),
        ({"outputs": True}, "'outputs' must be a name or a list of names, not true"),
        ({"on_failure": ["raise"]}, r"'on_failure' must be one of raise, return, not \[\"raise\"\]"),
        ({"inputs": {1: 2}}, r"'inputs' must be a dict from names to values, not \{\"1\":2\}"),
        ({"inputs": lambda time: {1: time}}, r"'inputs' must be a dict from names to values, not \{\"1\":0.0\}"),
        ({"link[1].mass": TOO_LARGE}, r"'link\[1\]\.mass' must be a number in kg"),
    ],
)
def test_a_run(arguments: dict[str, Any], sentence: str) -> None:
    with pytest.raises(FiveBarError, match=f"^{sentence}"):
        fivebar.run(FALL, stop_time=0.01, **arguments)


def inner() -> Callable[[Result], Any]:
    """A function that only this process has."""

    def reduce(result: Result) -> float:
        return float(result.time[-1])

    return reduce


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"scene": None}, "'scene' must be a scene or a list of scenes, not null"),
        (
            {"values": {"link[1].mass": 1.0}},
            r"'values' must be a list of dicts or a frame of pandas, one dict or row for each run, not \{",
        ),
        ({"values": 3}, "'values' must be a list of dicts or a frame of pandas, one dict or row for each run, not 3"),
        ({"processes": "x"}, "'processes' must be a whole number of at least 1, not \"x\""),
        ({"processes": 1.5}, "'processes' must be a whole number of at least 1, not 1.5"),
        ({"reduce": 3}, "'reduce' must be a function of a result, not 3"),
        (
            {"reduce": lambda result: 0},
            "'reduce' is <function <lambda> .*, which other processes cannot import: it must be",
        ),
        ({"reduce": inner()}, "'reduce' is <function inner.*, which other processes cannot import: it must be"),
    ],
)
def test_many_runs(arguments: dict[str, Any], sentence: str) -> None:
    given: dict[str, Any] = {"scene": FALL, "values": [{}, {}], "processes": 2, "progress": False} | arguments
    with pytest.raises(FiveBarError, match=f"^{sentence}"):
        fivebar.run_many(**given)


def test_one_process_takes_any_reduction() -> None:
    ends = fivebar.run_many(FALL, [{}, {}], reduce=inner(), processes=1, progress=False, stop_time=0.01)
    assert ends == [0.01, 0.01]


@pytest.mark.parametrize(
    ("call", "kind", "sentence"),
    [
        (lambda r: r[0], TypeError, "a column is chosen by its name, not by 0"),
        (lambda r: r[["tip.x"]], TypeError, r'a column is chosen by its name, not by \["tip.x"\]'),
        (lambda r: r.between(None, 0.1), FiveBarError, "'begin' must be a number in s, not null"),
        (lambda r: r.between(0, [1]), FiveBarError, r"'end' must be a number in s, not \[1\]"),
        (
            lambda r: r.plot([["tip.x"]]),
            FiveBarError,
            r"'names' must be a name or a list of names, not \[\[\"tip.x\"\]\]",
        ),
    ],
)
def test_a_result(result: Result, call: Callable[[Any], Any], kind: type[Exception], sentence: str) -> None:
    with pytest.raises(kind, match=f"^{sentence}"):
        call(result)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: Scene.read(FALL)["tipp"], "there is no variable 'tipp'"),
        (lambda: Scene.read(FALL)["tip.x"], "'tip.x' is computed by the FMU and cannot be set"),
        (lambda: Scene.read(FALL).replace(True), "'values' must be a dict from names to values, not true"),
        (lambda: Scene.read(FALL).replace({1: 2}), "'values' must be a dict from names to values, not "),
        (lambda: Scene.read(FALL).coarser(None), "'step_size' must be a positive number of seconds, not null"),
        (lambda: fivebar.unit(FALL, True), "the name of a unit must be a text, not true"),
        (lambda: fivebar.unit(FALL, naming=[1]), r"naming is \[1\]: it must be structured or flat"),
        (lambda: Machine.from_values(None), "'values' must be a dict from names to values, not null"),
        (lambda: Machine.from_values({"link[1].length": "x"}), r"'link\[1\]\.length' must be a number in m, not \"x\""),
        (lambda: Machine.from_scene(FALL).direct_at(None), "'theta1' must be a number in rad, not null"),
        (
            lambda: Machine.from_scene(FALL).direct_singularities(-1),
            "'points' must be a whole number of at least 1, not -1",
        ),
    ],
)
def test_scenes_units_and_machines(call: Callable[[], Any], sentence: str) -> None:
    with pytest.raises(FiveBarError, match=f"^{sentence}"):
        call()
