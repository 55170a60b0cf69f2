"""The packed unit in FMPy: version, communication steps of many kinds, many instances.

tests/integration/fmi_*.rs and the masters in C prove the order of calls, reset, independence and the step grid.
"""

from collections.abc import Callable

import pytest
from fmpy.model_description import ModelDescription

from instance import Instance, Log, instantiate

FALL = {"init.theta[2]": 2.0943951023931953}
New = Callable[..., Instance]


def test_version_and_platform(new: New) -> None:
    slave = new().slave
    assert slave.getVersion() == "2.0"
    assert slave.getTypesPlatform() == "default"


@pytest.mark.parametrize("size", [1 / 60, 1 / 48_000 * 37, 0.0123456789, 1e-4])
def test_odd_communication_steps(new: New, size: float) -> None:
    """A communication step that is not a multiple of h changes the result only within the method's error."""
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
    """t += h deviates from i·h by rounding; the result has the same bits."""
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


def test_many_instances(model: ModelDescription, directory: str) -> None:
    for _ in range(50):
        slave = instantiate(model, directory, Log())
        slave.setupExperiment()
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        slave.doStep(0.0, 1e-3)
        slave.freeInstance()
