"""Signals of a scene: their values, how a run applies them, and the sentence for what is not one."""

import json
from pathlib import Path

import numpy as np
import pytest
from fmpy.model_description import ModelDescription

import scene
from drive import Progress, Run, drive
from signals import Signal

KNOTS = ((0.5, 1.0), (1.0, 3.0), (2.0, 2.0))


def read(folder: Path, content: dict[str, object], model: ModelDescription) -> scene.Scene:
    """A scene with `content`."""
    path = folder / "trial.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return scene.read(path, model)


@pytest.mark.parametrize("shape", ["linear", "minimumJerk"])
def test_a_signal_meets_its_knots_and_stays_outside(shape: str) -> None:
    signal = Signal(shape, KNOTS)
    assert signal.at(np.array([-1.0, 0.0, 0.5, 0.75, 1.0, 2.0, 9.0])).tolist() == [1.0, 1.0, 1.0, 2.0, 3.0, 2.0, 2.0]


@pytest.mark.parametrize("shape", ["linear", "minimumJerk"])
def test_a_rate_is_the_derivative(shape: str) -> None:
    """Against central differences away from the knots; their error is below step^2 times the third derivative, some 1e3."""
    signal, rate, step = Signal(shape, KNOTS), Signal(shape, KNOTS, rate=True), 1e-5
    time = np.array([0.1, 0.55, 0.7, 0.95, 1.1, 1.6, 1.99, 2.5])
    difference = (signal.at(time + step) - signal.at(time - step)) / (2 * step)
    assert rate.at(time) == pytest.approx(difference, abs=1e-6)


def test_a_minimum_jerk_rests_in_its_knots() -> None:
    """Rate and acceleration are 0 there, to the first order in the distance of 1e-6 s times the jerk of some 1e3."""
    rate, close = Signal("minimumJerk", KNOTS, rate=True), 1e-6
    for time, _ in KNOTS:
        around = rate.at(np.array([time - close, time, time + close]))
        assert np.max(np.abs(around)) < 1e-8 and np.max(np.abs(np.diff(around))) / close < 1e-2


def run(folder: Path, content: dict[str, object], model: ModelDescription, directory: str) -> Run:
    """A run of a scene."""
    ready = read(folder, content, model)
    return drive(model, directory, ready, ready.variants[0], Progress("trial", ready.stop_time))


def test_a_signal_is_held_from_each_communication_point(tmp_path: Path, model: ModelDescription, directory: str) -> None:
    """A ramp sampled at 0, 10, 20, ... ms is a flight of stairs that begins at 0."""
    ramp = {"linear": [[0, 0], [0.1, 1e-3]]}
    base = {"experiment": {"stopTime": 0.1, "stepSize": 0.01}, "gravity.enabled": False, "solver.stepSize": 1e-3}
    signalled = run(tmp_path, base | {"signals": {"tau[1]": ramp}}, model, directory)
    assert signalled["tau[1]"] == pytest.approx(np.linspace(0, 1e-3, 11), abs=1e-18)
    # The first step is made with the value at 0, which is none: the rest stays one, but for round-off.
    assert abs(signalled["omega[1]"][1]) < 1e-15 < 1e-4 < signalled["omega[1]"][2]
    # Work put in is held torque times turned angle, step by step; 1e-6 of it is the integrator's error.
    work = np.sum(signalled["tau[1]"][:-1] * np.diff(signalled["theta[1]"]))
    assert signalled["energy.input"][-1] == pytest.approx(work, rel=1e-6)


def test_the_start_has_the_signals_first_values(tmp_path: Path, model: ModelDescription, directory: str) -> None:
    content = {"experiment": {"stopTime": 0.01, "stepSize": 0.001}, "gravity.enabled": False}
    push = {"signals": {"tau[1]": {"linear": [[0, 0.1], [1, 0.2]]}}}
    held = run(tmp_path, content | {"tau[1]": 0.1}, model, directory)
    assert run(tmp_path, content | push, model, directory)["alpha[1]"][0] == held["alpha[1]"][0] != 0.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ([], ("'signals'", "object")),
        ({"servo.thta[1]": {"linear": [[0, 0], [1, 1]]}}, ("servo.thta[1]", "not an input", "did you mean", "servo.theta[1]")),
        ({"gravity.g": {"linear": [[0, 0], [1, 1]]}}, ("gravity.g", "not an input")),
        ({"tau[1]": 5}, ("tau[1]", "one of linear, minimumJerk, rateOf", "5")),
        ({"tau[1]": {"cubic": [[0, 0], [1, 1]]}}, ("tau[1]", "one of linear, minimumJerk, rateOf", "cubic")),
        ({"tau[1]": {"linear": [[0, 0]]}}, ("tau[1]", "two or more knots")),
        ({"tau[1]": {"linear": [[0, 0], [1, "a"]]}}, ("tau[1]", "knots [time in s, value]", '"a"')),
        ({"tau[1]": {"linear": [[0, 0], [1, 2, 3]]}}, ("tau[1]", "knots")),
        ({"tau[1]": {"linear": [[0, 0], [1, 1], [1, 2]]}}, ("tau[1]", "times must increase", "1 s follows 1 s")),
        ({"servo.omega[1]": {"rateOf": "servo.theta[1]"}}, ("servo.omega[1]", "rateOf", "rad/s", "servo.theta[1]")),
        (
            {"tau[1]": {"rateOf": "servo.theta[1]"}, "servo.theta[1]": {"linear": [[0, 0], [1, 1]]}},
            ("tau[1]", "rateOf", "N.m", "servo.theta[1]"),
        ),
        ({"servo.omega[1]": {"rateOf": 3}}, ("servo.omega[1]", "rateOf", "3")),
        ({"tau[2]": {"linear": [[0, 0], [1, 1]]}}, ("tau[2]", "a signal and a value")),
    ],
)
def test_refused(tmp_path: Path, model: ModelDescription, given: object, words: tuple[str, ...]) -> None:
    with pytest.raises(scene.SceneError) as refusal:
        read(tmp_path, {"signals": given, "tau[2]": 1}, model)
    assert "\n" not in str(refusal.value)
    for word in words:
        assert word in str(refusal.value)
