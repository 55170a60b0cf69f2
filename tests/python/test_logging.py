"""The logger's messages: warnings and worse always, events when logging is on, nothing once it is switched off."""

from collections.abc import Callable

import pytest
from fmpy import fmi2
from fmpy.fmi1 import FMICallException

from instance import Instance

New = Callable[..., Instance]


def provoke(instance: Instance) -> None:
    """A call that is always refused: the variable does not exist."""
    with pytest.raises(FMICallException):
        instance.slave.getReal([4_000_000_000])


def test_errors_are_logged_from_the_start(new: New) -> None:
    instance = new("quiet", logging_on=False)
    provoke(instance)
    (message,) = instance.log.messages
    assert (message.instance, message.status, message.category) == ("quiet", fmi2.fmi2Error, "logStatusError")
    assert "fmi2GetReal" in message.text


def test_events_only_when_logging_is_on(new: New) -> None:
    quiet, talking = new(logging_on=False), new(logging_on=True)
    for instance in (quiet, talking):
        instance.initialise()
        instance.slave.terminate()
    assert quiet.log.messages == []
    assert {m.category for m in talking.log.messages} == {"logEvents"}
    assert {m.status for m in talking.log.messages} == {fmi2.fmi2OK}


def test_debug_logging_off_is_silence(new: New) -> None:
    instance = new(logging_on=True)
    instance.slave.setDebugLogging(False, [])
    provoke(instance)
    instance.initialise()
    assert instance.log.messages == []


def test_chosen_categories(new: New) -> None:
    instance = new()
    instance.slave.setDebugLogging(True, ["logEvents"])
    provoke(instance)
    instance.initialise()
    assert {m.category for m in instance.log.messages} == {"logEvents"}
    instance.slave.setDebugLogging(True, ["logAll"])
    provoke(instance)
    assert instance.log.messages[-1].category == "logStatusError"


def test_undeclared_category(new: New) -> None:
    instance = new()
    status, text = instance.refusal(instance.slave.setDebugLogging, True, ["logMoon"])
    assert status == fmi2.fmi2Error and "logMoon" in text


def test_a_tolerance_is_answered_with_an_event(new: New) -> None:
    """FMPy and others pass one at every start."""
    quiet, talking = new(logging_on=False), new(logging_on=True)
    for instance in (quiet, talking):
        assert instance.slave.setupExperiment(tolerance=1e-6) in (None, fmi2.fmi2OK)
    assert quiet.log.messages == []
    (message,) = talking.log.messages
    assert (message.status, message.category) == (fmi2.fmi2OK, "logEvents") and "solver.errorTolerance" in message.text


def test_percent_signs_are_safe(new: New) -> None:
    """The standard makes the text a printf format; a name with a percent sign must appear unchanged."""
    instance = new("100 %s %n sure")
    provoke(instance)
    assert instance.log.messages[-1].instance == "100 %s %n sure"
