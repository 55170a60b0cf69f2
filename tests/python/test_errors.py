"""Refusals and their messages: variable, value, allowed range."""

import math
from collections.abc import Callable
from ctypes import byref, c_double

import pytest
from fmpy import fmi2
from fmpy.model_description import ModelDescription

from instance import Instance, Log, Values, instantiate

New = Callable[..., Instance]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"link[1].mass": -0.017}, ("link[1].mass", "0.017")),
        ({"link[2].mass": 0.0}, ("link[2].mass", "at least 1e-9 kg")),
        ({"link[3].inertia": 0.0}, ("link[3].inertia", "at least 1e-15 kg.m2")),
        ({"link[4].length": -0.1}, ("link[4].length", "-0.1")),
        ({"base.distance": -0.42}, ("base.distance", "-0.42")),
        ({"solver.stepSize": 0.0}, ("solver.stepSize", "at least 1e-9 s")),
        ({"solver.maxIterations": 0}, ("solver.maxIterations", "1")),
        ({"tau[1]": math.nan}, ("tau[1]", "finite")),
        ({"tip.fx": math.inf}, ("tip.fx", "finite")),
        ({"init.theta[1]": math.nan}, ("init.theta[1]", "finite")),
        ({"solver.method": 9}, ("solver.method", "9", "rk4")),
        ({"init.assembly": 0}, ("init.assembly", "plus", "minus")),
        # Elbows 0.84 m apart; the distal links reach 0.42 m.
        ({"init.theta[1]": math.pi, "init.theta[2]": 0.0}, ("0.84", "0.42")),
    ],
    ids=lambda v: " ".join(v) if isinstance(v, dict) else "",
)
def test_starts_that_are_refused(new: New, values: Values, words: tuple[str, ...]) -> None:
    """The setter refuses them, or the end of initialisation if several variables are involved."""
    instance = new()
    status, text = instance.refusal(instance.initialise, values)
    assert status == fmi2.fmi2Error
    for word in words:
        assert word in text
    assert "\n" not in text


def test_a_refused_value_is_not_written(new: New) -> None:
    instance = new()
    instance.refusal(instance.set, {"link[1].mass": -1.0})
    instance.enter()
    assert instance.get("link[1].mass") == 0.017


def test_nothing_is_half_written(new: New, model: ModelDescription) -> None:
    instance = new()
    references = [v.valueReference for v in model.modelVariables if v.name in ("tau[1]", "tau[2]")]
    instance.refusal(instance.slave.setReal, references, [1.0, math.nan])
    instance.enter()
    assert instance.get("tau[1]") == 0.0


def test_after_a_refused_start_the_instance_can_be_reset(new: New) -> None:
    instance = new()
    instance.refusal(instance.initialise, {"init.theta[1]": math.pi, "init.theta[2]": 0.0})
    instance.slave.reset()
    instance.initialise()
    instance.steps(3, 1e-3)
    assert instance.get("solver.steps") == 3


def test_unknown_references(new: New) -> None:
    instance = new().enter()
    slave = instance.slave
    for call in (slave.getReal, slave.getInteger, slave.getBoolean, slave.getString):
        status, text = instance.refusal(call, [4_000_000_000])
        assert status == fmi2.fmi2Error and "4000000000" in text
    for call in (slave.setReal, slave.setInteger, slave.setBoolean):
        assert instance.refusal(call, [4_000_000_000], [1])[0] == fmi2.fmi2Error
    assert instance.refusal(slave.setString, [4_000_000_000], ["x"])[0] == fmi2.fmi2Error


def test_references_of_another_type(new: New, model: ModelDescription) -> None:
    instance = new().enter()
    reference = {v.name: v.valueReference for v in model.modelVariables}
    status, text = instance.refusal(instance.slave.getReal, [reference["solver.method"]])
    assert status == fmi2.fmi2Error and "solver.method" in text
    assert "tau[1]" in instance.refusal(instance.slave.getInteger, [reference["tau[1]"]])[1]


def test_fixed_parameters_stay_fixed(new: New) -> None:
    instance = new().initialise()
    instance.steps(1, 1e-3)
    status, text = instance.refusal(instance.set, {"link[1].length": 0.3})
    assert status == fmi2.fmi2Error and "link[1].length" in text and "fixed" in text
    assert instance.get("link[1].length") == 0.21
    instance.set({"tau[1]": 0.1})


def test_outputs_cannot_be_set(new: New) -> None:
    instance = new()
    status, text = instance.refusal(instance.set, {"tip.x": 0.1})
    assert status == fmi2.fmi2Error and "tip.x" in text


def test_empty_calls_are_fine(new: New) -> None:
    slave = new().enter().slave
    assert slave.getReal([]) == slave.getInteger([]) == slave.getBoolean([]) == []
    slave.setReal([], [])


def test_wrong_guid(model: ModelDescription, directory: str) -> None:
    log = Log()
    with pytest.raises(Exception, match="Failed to instantiate"):
        instantiate(model, directory, log, guid="{00000000-0000-0000-0000-000000000000}")
    assert "00000000-0000-0000-0000-000000000000" in log.last()


def test_functions_of_capabilities_declared_false(new: New, model: ModelDescription) -> None:
    """Functions whose capability flag is false are exported, return fmi2Error and name the flag."""
    instance = new().initialise()
    slave, flags = instance.slave, model.coSimulation
    calls = []
    if not flags.canGetAndSetFMUstate:
        calls.append((slave.getFMUstate, (), "canGetAndSetFMUstate"))
    if not flags.canSerializeFMUstate:
        calls.append((slave.serializeFMUstate, (None,), "canSerializeFMUstate"))
        calls.append((slave.deSerializeFMUstate, (b"0",), "canSerializeFMUstate"))
    if not flags.providesDirectionalDerivative:
        calls.append((slave.getDirectionalDerivative, ([610], [100], [1.0]), "providesDirectionalDerivative"))
    if not flags.canInterpolateInputs:
        calls.append((slave.setRealInputDerivatives, ([100], [1], [0.0]), "canInterpolateInputs"))
    if not flags.maxOutputDerivativeOrder:
        calls.append((slave.getRealOutputDerivatives, ([610], [1]), "maxOutputDerivativeOrder"))
    for call, arguments, flag in calls:
        status, text = instance.refusal(call, *arguments)
        assert status == fmi2.fmi2Error and flag in text
    instance.steps(1, 1e-3)


def test_cancel_and_status(new: New) -> None:
    instance = new().initialise()
    instance.steps(2, 1e-3)
    assert instance.refusal(instance.slave.cancelStep)[0] == fmi2.fmi2Error
    value = c_double()
    assert (
        instance.slave.fmi2GetRealStatus(instance.slave.component, fmi2.fmi2LastSuccessfulTime, byref(value))
        == fmi2.fmi2OK
    )
    assert value.value == pytest.approx(2e-3, abs=1e-15)


def test_a_step_that_cannot_be_done_is_discarded(new: New) -> None:
    """One iteration of the printed method is not enough: the state is unchanged and the log states the time reached."""
    hopeless = {"tau[1]": 50.0, "solver.method": 2, "solver.maxIterations": 1}
    instance = new().initialise(hopeless)
    bits = instance.bits()
    status, text = instance.refusal(instance.slave.doStep, 0.0, 1e-3)
    assert status == fmi2.fmi2Discard and text
    assert instance.bits() == bits
    assert instance.slave.getRealStatus(fmi2.fmi2LastSuccessfulTime) == 0.0
