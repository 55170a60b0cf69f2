"""Motors in the summary, against the columns of the run and the law of the servos."""

import re
from pathlib import Path

import numpy as np
import pytest

import fivebar
from fivebar.result import Result

NUMBER = r"(\d\S*)"


@pytest.fixture(autouse=True)
def here(monkeypatch: pytest.MonkeyPatch, fmu: Path) -> None:
    monkeypatch.setenv("FIVEBAR_FMU", str(fmu))


def facts(result: Result) -> dict[str, str]:
    """The lines of the summary about motors, by name; empty if there are none."""
    lines = result.summary().splitlines()
    first = lines.index(result.own.label) + 1
    if not lines[first].startswith("  motors, "):
        assert not any("motors, " in line for line in lines)
        return {}
    block = lines[first + 1 :]
    end = next(i for i, line in enumerate(block) if not line.startswith("    "))
    return {line[4:30].strip(): line[30:] for line in block[:end]}


def sizes(text: str, unit: str) -> list[float]:
    """Rms, peak and time of the peak in a line."""
    found = re.fullmatch(rf"rms {NUMBER}, peak {NUMBER} {re.escape(unit)} at t = {NUMBER} s", text)
    assert found, text
    return [float(number) for number in found.groups()]


def expected(result: Result, course: np.ndarray) -> list[float]:
    """Rms, peak and time of the peak of a column, to the printed digits."""
    row = int(np.argmax(np.abs(course)))
    return [
        pytest.approx(float(np.sqrt(np.mean(course**2))), rel=5e-3),
        pytest.approx(float(np.abs(course[row])), rel=5e-3),
        pytest.approx(float(result.time[row]), rel=5e-4),
    ]


def test_servo_steps(fmu: Path) -> None:
    """A servo is saturated while its gains ask for more than its limit; with constant references the columns have both torques."""
    result = fivebar.run("servo_step")
    found = facts(result)
    assert list(found) == [
        "tracking error, left", "tracking error, right", "torque, left", "torque, right", "rate, left", "rate, right", "servos saturated",
    ]  # fmt: skip
    p, shares = result.own.parameters, []
    for i, side, reference in ((1, "left", 1.2), (2, "right", 2.4)):
        error = reference - result[f"theta[{i}]"]
        assert sizes(found[f"tracking error, {side}"], "rad") == expected(result, error)
        assert sizes(found[f"torque, {side}"], "N.m") == expected(result, result[f"servo.torque[{i}]"])
        assert sizes(found[f"rate, {side}"], "rad/s") == expected(result, result[f"omega[{i}]"])
        asked = p[f"servo.kp[{i}]"] * error - p[f"servo.kd[{i}]"] * result[f"omega[{i}]"]
        shares.append(f"{side} {100 * np.mean(np.abs(asked) > p[f'servo.limit[{i}]']):.1f} %")
    assert found["servos saturated"] == f"{', '.join(shares)} of the time" and " 0.0 %" not in found["servos saturated"]


def test_a_motor_without_a_servo_tracks_nothing(fmu: Path) -> None:
    """A motor without a servo has no tracking error, a motor without a torque no torque."""
    assert list(facts(fivebar.run("stiff_servo", stop_time=0.05))) == [
        "tracking error, left", "torque, left", "rate, left", "rate, right", "servos saturated",
    ]  # fmt: skip
    pushed = fivebar.run("swing", stop_time=0.1, inputs={"tau[2]": ([0, 0.1], [0, -0.02])})
    found = facts(pushed)
    assert list(found) == ["torque, right", "rate, left", "rate, right"]
    assert sizes(found["torque, right"], "N.m") == expected(pushed, pushed["tau[2]"])
    # Both kinds of torque act on one motor.
    both = fivebar.run("servo_step", stop_time=0.05, **{"tau[1]": 0.25})
    assert sizes(facts(both)["torque, left"], "N.m") == expected(both, both["servo.torque[1]"] + 0.25)
    assert facts(fivebar.run("fall_90_120", stop_time=0.05)) == {}


def test_the_tip_has_an_error_where_it_has_references(fmu: Path) -> None:
    scene = {
        "experiment": {"stopTime": 0.6}, "gravity.enabled": False, "servo.enabled": True, "base.distance": 0.1, "tip.y": 0.25,
        "signals": {"tip.x": {"minimumJerk": [[0.1, 0.05], [0.5, 0.1]]}},
    }  # fmt: skip
    result = fivebar.run(scene)
    u = np.clip((result.time - 0.1) / 0.4, 0, 1)
    course = 0.05 + 0.05 * (10 * u**3 - 15 * u**4 + 6 * u**5)
    distance = np.hypot(course - result["tip.x"], 0.25 - result["tip.y"])
    assert sizes(facts(result)["tracking error, tip"], "mm") == expected(result, 1e3 * distance)
    assert "tracking error, tip" not in facts(fivebar.run("pick_and_place", stop_time=0.05))


def test_stops_are_reached_or_not(fmu: Path) -> None:
    result = fivebar.run("end_stops", stop_time=0.5, **{"stop.lower[1]": -20})
    found = facts(result)
    assert list(found) == ["stops, left", "stops, right"]
    beyond = result["theta[2]"] - result.own.parameters["stop.upper[2]"]
    times = np.count_nonzero(np.diff((beyond > 0).astype(int)) == 1)
    assert times and found["stops, right"] == (
        f"reached {times} time{'s' if times > 1 else ''}, by up to {beyond.max():.3g} rad at t = {result.time[beyond.argmax()]:g} s"
    )
    left = result["theta[1]"] - result.own.parameters["stop.upper[1]"]
    assert found["stops, left"] == f"not reached, {-left.max():.3g} rad away at t = {result.time[left.argmax()]:g} s"
