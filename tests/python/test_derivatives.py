"""Derivatives through FMPy: directional derivatives against differences, and derivatives of inputs and outputs by time."""

from collections.abc import Callable
from ctypes import c_double, c_int, c_uint32

import pytest
from fmpy import fmi2
from fmpy.model_description import ModelDescription

from instance import Instance

New = Callable[..., Instance]
START = {"init.theta[1]": 1.2, "init.theta[2]": 2.0, "init.omega[1]": 0.5}


def reference(model: ModelDescription, name: str) -> int:
    return next(v.valueReference for v in model.modelVariables if v.name == name)


def test_directional_derivatives_are_differences(new: New, model: ModelDescription) -> None:
    """The matrix for a master has the derivatives of accelerations with respect to torques and angles."""
    unknowns, step = ["alpha[1]", "alpha[2]", "tip.ax"], 1e-5
    references = [reference(model, name) for name in unknowns]

    def outputs(changes: dict[str, float]) -> list[float]:
        instance = new().initialise(START | changes)
        return [instance.get(name) for name in unknowns]

    slave = new().initialise(START).slave
    knowns = {"tau[1]": ("tau[1]", 0.0), "theta[2]": ("init.theta[2]", 2.0), "omega[1]": ("init.omega[1]", 0.5)}
    for known, (start, value) in knowns.items():
        got = slave.getDirectionalDerivative(references, [reference(model, known)], [1.0])
        above, below = outputs({start: value + step}), outputs({start: value - step})
        # Errors of differences: step² times third derivatives of some 1e3, and ε·1e2/step.
        assert list(got) == pytest.approx([(a - b) / (2 * step) for a, b in zip(above, below)], rel=1e-6, abs=1e-6)


def test_input_and_output_derivatives(new: New, model: ModelDescription) -> None:
    """Sets a ramp and reads its final value; the output's derivative is the rate."""
    instance = new().initialise(START | {"tau[1]": 0.01})
    slave = instance.slave
    tau, theta = (c_uint32 * 1)(reference(model, "tau[1]")), (c_uint32 * 1)(reference(model, "theta[1]"))
    order, slope, rate = (c_int * 1)(1), (c_double * 1)(0.5), (c_double * 1)()
    assert slave.fmi2SetRealInputDerivatives(slave.component, tau, 1, order, slope) == fmi2.fmi2OK
    instance.steps(1, 0.01)
    assert instance.get("tau[1]") == 0.01 + 0.01 * 0.5
    assert slave.fmi2GetRealOutputDerivatives(slave.component, theta, 1, order, rate) == fmi2.fmi2OK
    assert rate[0] == instance.get("omega[1]")
