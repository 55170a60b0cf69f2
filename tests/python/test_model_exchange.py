"""Model exchange: FMPy's CVode integrates the unit's equations, and CasADi uses the equations and their derivatives."""

from pathlib import Path

import numpy as np
import pytest
from fmpy import fmi2, simulate_fmu
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription
from fmpy.sundials import CVodeSolver

from fivebar import scene

MOTION = ["theta[1]", "theta[2]", "omega[1]", "omega[2]", "tip.x", "tip.y"]


def held(made: scene.Scene) -> np.ndarray:
    """Signals of a scene for FMPy, constant between communication points; changes are events for the integrator."""
    points = scene.communication_points(made.stop_time, made.step_size)
    table = np.zeros(2 * len(points) - 2, dtype=[("time", float), *((name, float) for name in made.signals)])
    table["time"] = np.repeat(points, 2)[1:-1]
    for name, values in made.signals.items():
        table[name] = np.repeat(values[:-1], 2)
    return table


def motion(fmu: Path, made: scene.Scene, kind: str | None, **settings: float) -> dict[str, np.ndarray]:
    """Outputs of a scene at its communication points, through FMPy."""
    result = simulate_fmu(
        str(fmu),
        fmi_type=kind,
        stop_time=made.stop_time,
        output_interval=made.step_size,
        start_values=made.variants[0].values,
        input=held(made) if made.signals else None,
        output=MOTION,
        record_events=False,
        **settings,
    )
    return {name: result[name] for name in ("time", *MOTION)}


def test_cvode_agrees_with_co_simulation(fmu: Path, scenes: Path) -> None:
    """With setpoints constant for 10 ms, both solve pick_and_place within their own tolerances. FMPy uses co-simulation unless asked."""
    made = scene.read(scenes / "pick_and_place.json").coarser(0.01)
    stepped = motion(fmu, made, None)
    assert np.ptp(stepped["tip.x"]) > 0.2
    finest = motion(fmu, made, "ModelExchange", relative_tolerance=1e-10)
    for name, bound in zip(MOTION, [3e-7, 3e-7, 3e-5, 3e-5, 1e-7, 1e-7]):
        # The unit's local error of 3e-9 rad per sub-step over some 1e3 of them; rates change within 1/100 s.
        assert np.max(np.abs(stepped[name] - finest[name])) < bound, name
    for tolerance in (1e-4, 1e-6):
        coarse = motion(fmu, made, "ModelExchange", relative_tolerance=tolerance)
        # CVode's tolerance over 160 intervals of a motion that forgets its errors, at nominal values of 1 rad.
        assert np.max(np.abs(coarse["theta[1]"] - finest["theta[1]"])) < 10 * tolerance


def test_cvode_ends_its_steps_at_kinks(fmu: Path, scenes: Path) -> None:
    """A tip bounces on a floor, located by the indicators. Both motions agree before the first contact and after it."""
    made = scene.read(scenes / "bounce.json").coarser(0.01)
    stepped, integrated = (
        motion(fmu, made, kind, **tight)
        for kind, tight in ((None, {}), ("ModelExchange", {"relative_tolerance": 1e-9}))
    )
    assert np.min(stepped["tip.y"]) < 0.2 < np.max(stepped["tip.y"][-50:]) + 0.01
    # Each contact amplifies earlier errors.
    assert np.max(np.abs(stepped["tip.y"] - integrated["tip.y"])) < 1e-5


def test_a_trial_out_of_reach_can_be_tried_shorter(fmu: Path, scenes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A master that reports a refusal to CVode continues with smaller steps; if the motion itself passes the singularity, it turns back there."""
    made, refused = scene.read(scenes / "end_stops.json").coarser(0.01, 0.3), []
    right_hand_side = CVodeSolver.f

    def f(self: CVodeSolver, *arguments: object) -> int:
        try:
            return right_hand_side(self, *arguments)
        except FMICallException as refusal:
            refused.append(refusal.status)
            return 1

    monkeypatch.setattr(CVodeSolver, "f", f)
    stepped, integrated = motion(fmu, made, None), motion(fmu, made, "ModelExchange", relative_tolerance=1e-6)
    assert set(refused) == {fmi2.fmi2Discard}
    before, behind = np.abs(stepped["tip.y"] - integrated["tip.y"])[[10, 20]]
    assert before < 1e-5 and behind > 0.05


@pytest.mark.full
def test_casadi_takes_equations_and_derivatives(fmu: Path, model: ModelDescription) -> None:
    """DaeBuilder's function is the unit's der(x); its Jacobians, from directional derivatives, agree with central differences."""
    import casadi as ca

    dae = ca.DaeBuilder("five_bar", str(fmu))
    start = {
        "base.distance": 0.1,
        "init.theta[1]": 2.7567,
        "init.theta[2]": 1.345,
        "init.omega[1]": 0.7,
        "viscous.enabled": 1,
    }
    for name, value in start.items():
        dae.set(name, value)
    f = dae.create("f", ["x", "u"], ["ode", "y"])
    assert (dae.nx(), dae.nu(), dae.ny()) == (4, 8, 16)
    x, u = np.array([2.6, 1.2, 0.7, -1.9]), np.array([0.01, -0.02, 0.3, -0.1, 0, 0, 0, 0])
    xs, us = ca.MX.sym("x", 4), ca.MX.sym("u", 8)
    jacobians = ca.Function("J", [xs, us], [ca.jacobian(of, by) for of in f(xs, us) for by in (xs, us)])(x, u)

    def values(x: np.ndarray, u: np.ndarray) -> list[np.ndarray]:
        return [np.array(value).ravel() for value in f(x, u)]

    def differences(of: int, by: int, size: int) -> np.ndarray:
        step, columns = 1e-6, []
        for change in step * np.eye(size):
            there, back = ((x + s * change, u) if by == 0 else (x, u + s * change) for s in (1, -1))
            columns.append((values(*there)[of] - values(*back)[of]) / (2 * step))
        return np.array(columns).T

    for i, found in enumerate(jacobians):
        expected = differences(i // 2, i % 2, (4, 8)[i % 2])
        # Truncation: third derivatives times 1e-12; accelerations are some 1e2 rad/s² and their derivatives some 1e3.
        assert np.max(np.abs(np.array(found) - expected)) < 1e-7 * (1 + np.max(np.abs(expected)))
    assert np.max(np.abs(np.array(jacobians[0])[2:])) > 1 and np.max(np.abs(np.array(jacobians[1])[2:])) > 1
    assert np.array_equal(values(x, u)[0][:2], x[2:])
