"""Scenes in the tip's coordinates: starts and references by inverse kinematics; errors name the time."""

import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fivebar import scene as scenes
from fivebar import simulate
from fivebar.errors import FiveBarError
from fivebar.kinematics import WORKING_MODES, Machine, sines
from fivebar.scene import Scene
from instance import Instance
from made_scene import TABLE, UNEVEN

LINE = {
    "tip.x": {"minimumJerk": [[0.1, -0.06], [0.6, 0.16]]},
    "tip.y": {"linear": [[0.1, 0.24], [0.35, 0.27], [0.6, 0.24]]},
}


def read(content: dict[str, Any], name: str = "made") -> Scene:
    """A scene from the content of its file."""
    return scenes.parse(
        name, json.dumps({"description": "trial", "experiment": {"stopTime": 0.7, "stepSize": 0.001}} | content)
    )


@pytest.mark.parametrize("working", WORKING_MODES)
@pytest.mark.parametrize("place", [(0.07, 0.21), (0.12, -0.2)])
def test_the_unit_starts_there(
    new: Callable[..., Instance], working: tuple[str, str], place: tuple[float, float]
) -> None:
    """The unit starts with the tip at the place, in the working mode, and in the resulting assembly; both assemblies occur."""
    scene = read(UNEVEN | {"tip.x": place[0], "tip.y": place[1], "mode.working": list(working)})
    unit = new().initialise(scene.values)
    # Tolerance: some roundings of lengths below 1 m.
    assert unit.tip() == pytest.approx(place, abs=1e-14)
    theta = [unit.get(name) for name in ("theta[1]", "passive.theta[1]", "passive.theta[2]", "theta[2]")]
    side, left, right = sines(theta)
    assert [left > 0, right > 0] == [bend == "plus" for bend in working]
    assert scene.values.get("init.assembly", 1) == (1 if side > 0 else 2) and not {"tip.x", "mode.working"} & set(
        scene.values
    )
    named = UNEVEN | {
        "tip.x": place[0],
        "tip.y": place[1],
        "mode.working": list(working),
        "mode.assembly": "plus" if side > 0 else "minus",
    }
    assert read(named).values == scene.values


def test_references_are_exact() -> None:
    """At every communication point the servos' angles put the tip on its signals, and the rates of the tip match."""
    scene = read(TABLE | {"mode.working": ["minus", "plus"], "signals": LINE})
    machine, time = Machine.from_scene(scene), scene.time
    motors, rates = (
        np.stack([scene.signals[f"servo.{what}[{i}]"] for i in (1, 2)], axis=-1) for what in ("theta", "omega")
    )
    assert set(scene.signals) == {"servo.theta[1]", "servo.theta[2]", "servo.omega[1]", "servo.omega[2]"}
    u = np.clip((time - 0.1) / 0.5, 0, 1)
    x, dx = -0.06 + 0.22 * (10 * u**3 - 15 * u**4 + 6 * u**5), 0.22 / 0.5 * 30 * u**2 * (1 - u) ** 2
    y = 0.24 + 0.03 * np.clip(1 - np.abs(time - 0.35) / 0.25, 0, 1)
    # At a knot the rate belongs to the next piece.
    dy = np.where((time >= 0.1) & (time < 0.35), 0.12, np.where((time >= 0.35) & (time < 0.6), -0.12, 0.0))
    posture = machine.forward(motors)
    assert np.abs(posture.tip - np.stack([x, y], axis=-1)).max() < 1e-14
    # Rates to 1e-13 of 0.4 m/s: some roundings, also of times next to a knot.
    assert np.abs(machine.tip_velocity(posture.theta, rates) - np.stack([dx, dy], axis=-1)).max() < 1e-13
    assert [scene.values[f"init.theta[{i}]"] for i in (1, 2)] == motors[0].tolist()


def test_the_machine_follows() -> None:
    """In the unit the tip reaches the end of the signals and is never far from them."""
    scene = read(TABLE | {"signals": LINE, "payload.enabled": True})
    result = simulate.run(scene)
    assert result.failure is None
    assert [result["tip.x"][-1], result["tip.y"][-1]] == pytest.approx([0.16, 0.24], abs=2e-4)


def test_a_coordinate_without_signal_stays() -> None:
    scene = read(TABLE | {"tip.y": 0.24, "signals": {"tip.x": LINE["tip.x"]}})
    motors = np.stack([scene.signals[f"servo.theta[{i}]"] for i in (1, 2)], axis=-1)
    tip = Machine.from_scene(scene).forward(motors).tip
    assert np.abs(tip[:, 1] - 0.24).max() < 1e-14 and np.ptp(tip[:, 0]) == pytest.approx(0.22, abs=1e-14)


def test_start_and_signals_may_differ() -> None:
    """A start is given by the tip's place, or by angles, which also determine the working mode."""
    elsewhere = read(TABLE | {"tip.x": 0.05, "tip.y": 0.2, "signals": LINE})
    assert elsewhere.values["init.theta[1]"] != elsewhere.signals["servo.theta[1]"][0]
    machine = Machine.from_scene(elsewhere)
    for working in WORKING_MODES[:2]:
        motors = machine.inverse((0.05, 0.25), working).motors
        scene = read(TABLE | {"init.theta[1]": motors[0], "init.theta[2]": motors[1], "signals": LINE})
        commanded = [scene.signals[f"servo.theta[{i}]"][0] for i in (1, 2)]
        assert machine.inverse((-0.06, 0.24), working).motors == pytest.approx(commanded, abs=1e-14)


def test_angles_are_in_the_turn_of_stops_and_springs() -> None:
    """Angles are in [-pi, pi] unless stops or springs need another turn; signals continue without jumps, beyond a turn if necessary."""
    place = {"tip.x": -0.15, "tip.y": -0.1}
    plain = read(TABLE | place).values["init.theta[1]"]
    assert -np.pi <= plain < 0
    stopped = (
        TABLE
        | place
        | {
            "stop.enabled": True,
            "stop.lower[1]": 3.0,
            "stop.upper[1]": 5.0,
            "stop.lower[2]": -1.0,
            "stop.upper[2]": 6.0,
        }
    )
    sprung = TABLE | place | {"spring.enabled": True, "spring.theta0[1]": 9.0}
    assert read(stopped).values["init.theta[1]"] == plain + 2 * np.pi
    assert abs(read(sprung).values["init.theta[1]"] - 9.0) < np.pi
    angle = np.linspace(0, 4 * np.pi, 201)
    around = {
        axis: {"linear": [[0.003 * i, float(0.05 * (axis == "tip.x") + 0.3 * way(a))] for i, a in enumerate(angle)]}
        for axis, way in (("tip.x", np.cos), ("tip.y", np.sin))
    }
    scene = read(TABLE | {"signals": around})
    assert (
        np.abs(np.diff(scene.signals["servo.theta[1]"])).max() < 0.1
        and np.ptp(scene.signals["servo.theta[1]"]) > 4 * np.pi - 0.1
    )


def test_overlays_and_changes_start_there_too() -> None:
    """A run with other lengths starts at the same place; commands stay those for the scene's machine."""
    longer = {"label": "longer", "link[1].length": 0.25}
    scene = read(TABLE | {"overlay": [longer, {"label": "turned", "init.theta[1]": 2.0}], "signals": LINE})
    begun = [
        Machine.from_values(lengths).inverse((-0.06, 0.24)).motors[0]
        for lengths in ({"base.distance": 0.1}, {"base.distance": 0.1, "link[1].length": 0.25})
    ]
    assert [variant.values["init.theta[1]"] for variant in scene.variants] == [*begun, 2.0]
    changed = scene.replace({"link[2].length": 0.3})
    machine = Machine.from_scene(changed)
    assert changed.values["init.theta[1]"] == machine.inverse((-0.06, 0.24)).motors[0]
    assert (
        changed.variants[2].values["init.theta[1]"] == 2.0 and changed.variants[1].values["init.theta[1]"] not in begun
    )
    motors = np.stack([changed.signals[f"servo.theta[{i}]"] for i in (1, 2)], axis=-1)
    assert machine.forward(motors[-1]).tip == pytest.approx([0.16, 0.24], abs=1e-14)
    assert scene.coarser(0.01).replace({"link[1].mass": 0.02}).signals["servo.theta[1]"].shape == (71,)


def line(x: tuple[float, float], y: tuple[float, float]) -> dict[str, Any]:
    """A straight line within 0.5 s."""
    return {
        "signals": {"tip.x": {"linear": [[0.1, x[0]], [0.6, x[1]]]}, "tip.y": {"linear": [[0.1, y[0]], [0.6, y[1]]]}}
    }


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ({"tip.x": 0.05}, "'tip.y' must be given as well, as the tip's place at the start or as a signal"),
        ({"tip.x": 0.05, "tip.y": "high"}, "'tip.y' must be a number in m, not \"high\""),
        ({"tip.x": 0.05, "tip.y": True}, "'tip.y' must be a number in m, not true"),
        (
            {"tip.x": 0.05, "tip.y": 0.5},
            "the start: tip = (0.05, 0.5) m is out of reach of the left leg: it is 0.5024937811 m from the leg's motor",
        ),
        ({"mode.working": ["minus", "plus"]}, "'mode.working' has no effect without 'tip.x' and 'tip.y'"),
        (
            {"tip.x": 0.05, "tip.y": 0.25, "mode.working": "minusPlus"},
            "'mode.working' must be the bends of the left and the right leg",
        ),
        (
            {"tip.x": 0.05, "tip.y": 0.25, "mode.working": ["minus", 1]},
            "'mode.working' must be the bends of the left and the right leg",
        ),
        (
            {"tip.x": 0.05, "tip.y": 0.25, "mode.assembly": "left"},
            "'mode.assembly' must be one of plus, minus, not \"left\"",
        ),
        (
            {"tip.x": 0.05, "tip.y": 0.25, "mode.assembly": "minus"},
            "'mode.assembly' is minus, but with 'tip.x' = 0.05 m and 'tip.y' = 0.25 m",
        ),
        (
            {"tip.x": 0.05, "tip.y": 0.25, "init.theta[1]": 2},
            "'init.theta[1]' follows from 'tip.x' and 'tip.y', and cannot be given as well",
        ),
        (
            line((0, 0.1), (0.2, 0.25)) | {"servo.theta[2]": 1.0},
            "'servo.theta[2]' follows from signals 'tip.x' and 'tip.y'",
        ),
        (
            {"signals": LINE | {"servo.omega[1]": {"linear": [[0, 0], [1, 1]]}}},
            "'servo.omega[1]' follows from signals 'tip.x' and 'tip.y'",
        ),
        (
            {"signals": LINE, "overlay": [{"label": "other", "servo.theta[1]": 1}]},
            "'servo.theta[1]' has a signal and a value",
        ),
        (
            {"signals": {"tip.x": {"rateOf": "tip.y"}, "tip.y": LINE["tip.y"]}},
            "signal 'tip.x': 'rateOf' must name a signal with knots whose rate has the unit m",
        ),
        ({"signals": {"tip.x": LINE["tip.x"]}}, "'tip.y' must be given as well"),
        ({"signals": {"tip.vx": LINE["tip.x"]}}, "'tip.vx' is not an input of the FMU"),
        # 0.1 + 0.5 (s - 0.05)/0.6 is the time at the place s = sqrt(0.42^2 - 0.05^2) = 0.417013 on the rim.
        (
            line((0.05, 0.05), (0.2, 0.8)),
            "signals 'tip.x', 'tip.y' at 0.281 s: tip = (0.05, 0.4172) m is out of reach of the left leg",
        ),
        # Watt's curve is passed on the axis at y = sqrt(0.21^2 - 0.16^2) = 0.136015.
        (
            line((0.05, 0.05), (0.236, 0.036)),
            "between 0.349 and 0.35 s the tip crosses a direct singularity of working mode minus, plus",
        ),
    ],
)
def test_mistakes(content: dict[str, Any], sentence: str) -> None:
    with pytest.raises(FiveBarError, match=re.escape(sentence)):
        read(TABLE | content)
