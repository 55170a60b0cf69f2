"""Life cycle, clock and step grid: what a master relies on."""

from collections.abc import Callable

import pytest
from fmpy import fmi2
from fmpy.model_description import ModelDescription

from instance import Instance
from slave import Log, instantiate

FALL = {"init.theta[2]": 2.0943951023931953}
New = Callable[..., Instance]


def test_version_and_platform(new: New) -> None:
    slave = new().slave
    assert slave.getVersion() == "2.0"
    assert slave.getTypesPlatform() == "default"


@pytest.mark.parametrize("before", ["nothing", "setup", "initialization mode"])
def test_step_before_initialisation(new: New, before: str) -> None:
    instance = new()
    if before != "nothing":
        instance.slave.setupExperiment()
    if before == "initialization mode":
        instance.slave.enterInitializationMode()
    status, text = instance.refusal(instance.slave.doStep, 0.0, 1e-3)
    assert status == fmi2.fmi2Error and "fmi2DoStep" in text


def test_wrong_order_leaves_the_instance_usable(new: New) -> None:
    """Calls out of order are refused; what follows gives the bits of an instance that never saw them."""
    plain = new().initialise(FALL)
    plain.steps(50, 1e-3)

    instance = new()
    assert instance.refusal(instance.slave.exitInitializationMode)[0] == fmi2.fmi2Error
    assert instance.refusal(instance.slave.terminate)[0] == fmi2.fmi2Error
    instance.initialise(FALL)
    assert instance.refusal(instance.slave.enterInitializationMode)[0] == fmi2.fmi2Error
    assert instance.refusal(instance.slave.setupExperiment)[0] == fmi2.fmi2Error
    instance.steps(50, 1e-3)
    assert instance.bits() == plain.bits()


def test_after_terminate(new: New) -> None:
    instance = new().initialise()
    instance.steps(3, 1e-3)
    bits = instance.bits()
    instance.slave.terminate()
    assert instance.bits() == bits, "outputs stay readable"
    assert instance.refusal(instance.slave.doStep, 3e-3, 1e-3)[0] == fmi2.fmi2Error
    assert instance.refusal(instance.slave.terminate)[0] == fmi2.fmi2Error


def test_reset_is_a_fresh_instance(new: New) -> None:
    fresh = new().initialise(FALL)
    used = new().initialise({"tau[1]": 0.25, "init.assembly": 2, "gravity.enabled": False}, stop_time=1.0)
    used.steps(100, 1e-3)
    used.slave.reset()
    used.enter()
    untouched = new().enter()
    for name in ("tau[1]", "init.assembly", "gravity.enabled"):
        assert used.get(name) == untouched.get(name)
    used.slave.reset()
    used.initialise(FALL)
    assert used.bits() == fresh.bits()
    fresh.steps(300, 1e-3)
    used.steps(300, 1e-3)
    assert used.bits() == fresh.bits()


def test_two_instances_do_not_touch_each_other(new: New) -> None:
    alone = []
    for values in (FALL, {"tau[1]": 0.25}):
        instance = new().initialise(values)
        instance.steps(200, 1e-3)
        alone.append(instance.bits())
    first, second = new("first").initialise(FALL), new("second").initialise({"tau[1]": 0.25})
    for i in range(200):
        first.slave.doStep(i * 1e-3, 1e-3)
        second.slave.doStep(i * 1e-3, 1e-3)
    assert [first.bits(), second.bits()] == alone


@pytest.mark.parametrize("method", [1, 2, 3, 4])
def test_one_step_is_n_steps(new: New, method: int) -> None:
    """One H = n times H/n, bit for bit, for multiples of solver.stepSize."""
    results = []
    for count, size in ((1, 0.06), (6, 0.01), (60, 0.001)):
        instance = new().initialise(FALL | {"solver.method": method, "tau[1]": 0.02})
        instance.steps(count, size)
        results.append(instance.bits())
    assert results[0] == results[1] == results[2]


def test_reading_outputs_does_not_change_the_run(new: New) -> None:
    silent, curious = new().initialise(FALL), new().initialise(FALL)
    for i in range(100):
        silent.slave.doStep(i * 1e-3, 1e-3)
        curious.slave.doStep(i * 1e-3, 1e-3)
        curious.bits()
    assert silent.bits() == curious.bits()


@pytest.mark.parametrize("size", [1 / 60, 1 / 48_000 * 37, 0.0123456789, 1e-4])
def test_odd_communication_steps(new: New, size: float) -> None:
    """A communication step that is no multiple of h changes the result within the method's error only."""
    count = round(0.5 / size)
    odd, even = new().initialise(FALL), new().initialise(FALL)
    odd.steps(count, size)
    whole = int(count * size / 1e-3)
    even.steps(whole, 1e-3)
    rest = count * size - whole * 1e-3
    if rest > 1e-9:
        even.slave.doStep(whole * 1e-3, rest)
    assert odd.tip() == pytest.approx(even.tip(), abs=1e-5)


def test_a_master_whose_clock_accumulates(new: New) -> None:
    """t += h drifts away from i·h by rounding; the result keeps its bits."""
    accumulating, exact = new().initialise(FALL, stop_time=1.0), new().initialise(FALL, stop_time=1.0)
    exact.steps(1000, 1e-3)
    time = 0.0
    for _ in range(1000):
        accumulating.slave.doStep(time, 1e-3)
        time += 1e-3
    assert time != 1.0
    assert accumulating.bits() == exact.bits()


def test_start_time_above_zero(new: New) -> None:
    late, early = new().initialise(FALL, start_time=1000.0), new().initialise(FALL)
    late.steps(100, 1e-3, begin=1000.0)
    early.steps(100, 1e-3)
    assert late.bits() == early.bits()


@pytest.mark.parametrize(
    ("point", "size", "named"),
    [
        (0.5, 1e-3, "currentCommunicationPoint"),
        (-1e-3, 1e-3, "currentCommunicationPoint"),
        (float("nan"), 1e-3, "currentCommunicationPoint"),
        (0.0, 0.0, "communicationStepSize"),
        (0.0, -1e-3, "communicationStepSize"),
        (0.0, float("nan"), "communicationStepSize"),
        (0.0, 2.0, "stopTime"),
    ],
)
def test_steps_that_are_refused(new: New, point: float, size: float, named: str) -> None:
    instance = new().initialise(FALL, stop_time=1.0)
    bits = instance.bits()
    status, text = instance.refusal(instance.slave.doStep, point, size)
    assert status == fmi2.fmi2Error and named in text
    assert instance.bits() == bits
    instance.slave.doStep(0.0, 1e-3)


def test_an_input_of_the_same_value_changes_no_bit(new: New) -> None:
    once, again = (new().initialise({"tau[1]": 0.1}) for _ in range(2))
    for i in range(50):
        again.set({"tau[1]": 0.1})
        once.slave.doStep(i * 1e-3, 1e-3)
        again.slave.doStep(i * 1e-3, 1e-3)
    assert once.bits() == again.bits()


def test_an_input_acts_from_the_next_step_on(new: New) -> None:
    pushed, free = (new().initialise({"gravity.enabled": False}) for _ in range(2))
    for instance in (pushed, free):
        instance.steps(10, 1e-3)
    pushed.set({"tau[1]": 0.05})
    pushed.slave.doStep(0.01, 1e-3)
    free.slave.doStep(0.01, 1e-3)
    assert pushed.get("omega[1]") > 1e-3 and abs(free.get("omega[1]")) < 1e-20


def test_many_instances(model: ModelDescription, directory: str) -> None:
    for _ in range(50):
        slave = instantiate(model, directory, Log())
        slave.setupExperiment()
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        slave.doStep(0.0, 1e-3)
        slave.freeInstance()
