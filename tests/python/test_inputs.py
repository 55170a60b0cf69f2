"""Inputs of a run in Python: every form gives the same values over time; refusals are one sentence."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

import fivebar
from fivebar.errors import FiveBarError, MachineWarning
from fivebar.inputs import sampled
from fivebar.scene import read
from fivebar.variables import of_unit

POINTS = np.linspace(0, 0.1, 101)
RAMP = 0.2 * POINTS
TABLE = pandas.DataFrame({"time": [0, 0.1], "tau[1]": [0, 0.02]})


@pytest.mark.parametrize(
    "given",
    [
        {"tau[1]": RAMP},
        {"tau[1]": RAMP.tolist()},
        {"tau[1]": ([0, 0.1], [0, 0.02])},
        {"time": [0, 0.1], "tau[1]": [0, 0.02]},
        TABLE,
        TABLE.set_index("time"),
        lambda time: {"tau[1]": 0.2 * time},
        {"tau": np.column_stack([RAMP, 0 * RAMP])},
        {"tau": ([0, 0.1], [[0, 0], [0.02, 0]])},
        {"time": [0, 0.1], "tau": [[0, 0], [0.02, 0]]},
        lambda time: {"tau": (0.2 * time, np.array(0.0))},
    ],
    ids=["values", "list", "pair", "times", "frame", "frame by time", "function", "array", "pair of array", "times of array", "function of array"],
)  # fmt: skip
def test_every_form_gives_the_same_values(given: Any, fmu: Path) -> None:
    """Equal to a scene file with these knots, up to round-off of linear interpolation."""
    content = {"description": "a", "experiment": {"stopTime": 0.1}, "gravity.enabled": False}
    knots = {"signals": {"tau[1]": {"linear": [[0, 0], [0.1, 0.02]]}}}
    by_file = fivebar.run(content | knots, outputs="tip")
    result = fivebar.run(content, inputs=given, outputs="tip")
    assert result["tau[1]"] == pytest.approx(RAMP, abs=1e-16)
    assert result["tip.x"] == pytest.approx(by_file["tip.x"], abs=1e-12)
    assert result.scene.signals.keys() - {"tau[2]"} == {"tau[1]"} and np.ptp(result["tip.x"]) > 1e-4


def test_inputs_replace_values_of_the_scene(fmu: Path) -> None:
    """Inputs replace signals and start values; a constant is one number; tunable parameters are allowed."""
    pushed = read("paper_torque").replace(stop_time=0.01, inputs={"tau[1]": 0.1, "payload.mass": np.linspace(0, 1, 11)})
    assert "tau[1]" not in pushed.values and pushed.signals["tau[1]"].tolist() == [0.1] * 11
    assert all("tau[1]" not in variant.values for variant in pushed.variants)
    path = read("pick_and_place")
    still = path.replace(inputs={"servo.omega[1]": 0.0})
    assert not still.signals["servo.omega[1]"].any() and still.signals.keys() == path.signals.keys()
    # At other communication points of the run each sample is constant until the next.
    assert pushed.replace(step_size=5e-4).signals["payload.mass"].tolist() == [
        *np.repeat(np.linspace(0, 0.9, 10), 2).tolist(), 1.0
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"tau[1]": [0, 1]}, "the input 'tau[1]' has 2 values, but the run has 101 communication points: one value for each, or a pair (times, values), is needed"),
        ({"tau[1]": ([0, 1], [0, 1, 2])}, "the input 'tau[1]' has 3 values but 2 values of time: the counts must be equal"),
        ({"tau[1]": ([0, 1, 1], [0, 1, 2])}, "the times of input 'tau[1]' must increase, but 1.0 s follows 1.0 s"),
        ({"tau[1]": np.where(POINTS == POINTS[3], np.nan, 0)}, "the input 'tau[1]' must be finite, but is nan at 0.003 s"),
        ({"tau[1]": ([0, 0.05, 0.1], [0, np.nan, 1])}, "the input 'tau[1]' must be finite, but is nan at 0.05 s"),
        ({"payload.mass": -1}, "'payload.mass' must be a number in kg from 0 to 1000000000, not -1.0"),
        ({"tau[1]": ["a"]}, "the input 'tau[1]' must have one number for each time, not [\"a\"]"),
        ({"tau": 1}, "the input 'tau' has 2 elements, tau[1] to tau[2]: a number for each, "),
        ({"tau": ([0, 1], [0, 1])}, "the input 'tau' has 2 elements, tau[1] to tau[2]: a number for each, "),
        ({"tau": ([[0], [0, 1]], [1, 2])}, "the input 'tau' has 2 elements, tau[1] to tau[2]: a number for each, "),
        ({"time": [0, 1], "tau[1]": [0, 1, 2]}, "the input 'tau[1]' has 3 values but 2 values of time: the counts must be equal"),
        ({"tau[1]": (0.1, 0.2)}, "the input 'tau[1]' must be a number, values at the communication points, or a pair of lists (times, values), not [0.1,0.2]"),
        ({"tau[1]": [[1], [1, 2]]}, "the input 'tau[1]' must have one number for each time, not [[1],[1,2]]"),
        ({"torque": 1}, "'torque' is not an input of the FMU"),
        ({"link[1].mass": 1}, "'link[1].mass' is a fixed parameter: it keeps its start value"),
        ({"tip.x": 1}, "'tip.x' is not an input of the FMU"),
        (7, "inputs are a dict, a frame of pandas or a function of time, not 7"),
        (pandas.DataFrame({"tau[1]": RAMP}), "a frame of inputs needs a column or an index 'time', s"),
        (lambda _time: 3, "the function of inputs must return a dict with the same names at all times, but returned 3 at 0 s"),
        (lambda time: {"tau[1]": 1} | ({"tau[2]": 1} if time > 0.05 else {}), "the function of inputs must return a dict with the same names at all times"),
    ],
)  # fmt: skip
def test_inputs_that_cannot_be_are_one_sentence(given: Any, sentence: str, fmu: Path) -> None:
    with pytest.raises(FiveBarError) as refusal:
        sampled(given, POINTS, of_unit())
    assert str(refusal.value).startswith(sentence) and "\n" not in str(refusal.value)


def test_an_input_and_a_value_in_one_call_are_refused(fmu: Path) -> None:

    with pytest.raises(FiveBarError, match=r"^'tau\[1\]' has a signal and a value, but only one of them is allowed$"):
        fivebar.run("swing", inputs={"tau[1]": 0.1}, **{"tau[1]": 0.2})


def test_inputs_of_a_scene_are_known_to_its_end_only() -> None:
    """A longer run would keep the last value of a ramp, so it is refused; a constant continues."""
    given = read("flat_table").replace(stop_time=1.0, inputs={"tau[1]": ([0.0, 2.0], [0.0, 0.02]), "tau[2]": 0.01})
    assert given.replace(stop_time=0.5).signals["tau[1]"][-1] == pytest.approx(0.005)
    with pytest.raises(
        FiveBarError, match=r"the input 'tau\[1\]' is known up to 1 s: a run of 2 s needs `inputs` again"
    ):
        given.replace(stop_time=2.0)
    assert given.replace(stop_time=2.0, inputs={"tau[1]": 0.0}).signals["tau[2]"][-1] == 0.01


def test_times_in_milliseconds_are_warned_of_once() -> None:
    with pytest.warns(MachineWarning) as caught:
        read("swing").replace(stop_time=0.1, inputs={"time": [0, 50, 100], "tau[1]": [0, 0, 0], "tau[2]": [0, 0, 0]})
    [warning] = caught
    sentence = "the times of input 'tau[1]' end at 100 s, but the run at 0.1 s: are they in milliseconds?"
    assert str(warning.message) == sentence and warning.filename == __file__


def test_an_array_of_numbers_is_constant() -> None:
    signals = read("swing").replace(stop_time=0.01, inputs={"tau": (0.1, 0.2)}).signals
    assert set(signals["tau[1]"]) == {0.1} and set(signals["tau[2]"]) == {0.2}


def test_a_number_beside_times_is_constant() -> None:
    found = sampled({"time": [0, 0.05, 0.1], "tau": [0.1, 0.2], "payload.mass": np.float64(0.3)}, POINTS, of_unit())
    assert {name: set(values) for name, values in found.items()} == {
        "tau[1]": {0.1},
        "tau[2]": {0.2},
        "payload.mass": {0.3},
    }


def test_times_are_finite() -> None:
    with pytest.raises(FiveBarError, match=r"the times of input 'tau\[1\]' must be finite"):
        read("swing").replace(inputs={"tau[1]": ([np.nan], [1.0])})
