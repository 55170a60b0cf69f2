"""Every variable, by its declared type."""

from collections.abc import Callable

import pytest
from fmpy.model_description import ModelDescription

from instance import Instance


def parsed(variable: object) -> float | int:
    """The start value of the XML as fmi2Get… returns it."""
    if variable.type == "Boolean":
        return {"true": 1, "false": 0}[variable.start]
    return float(variable.start) if variable.type == "Real" else int(variable.start)


def test_a_fresh_instance_holds_the_starts_of_the_xml(new: Callable[..., Instance], model: ModelDescription) -> None:
    instance = new().enter()
    with_start = [v for v in model.modelVariables if v.start is not None]
    assert len(with_start) > 30
    for variable in with_start:
        assert instance.get(variable.name) == parsed(variable), variable.name


def test_all_that_is_computed_can_be_read_after_initialisation(new: Callable[..., Instance]) -> None:
    instance = new().initialise({"init.theta[2]": 2.0943951023931953})
    for name in instance.computed:
        assert instance.get(name) == instance.get(name), f"{name} is NaN or changes when read"


@pytest.mark.parametrize("name", ["tau[1]", "link[3].mass", "init.theta[2]", "solver.stepSize", "gravity.tilt"])
def test_what_is_set_is_read(new: Callable[..., Instance], name: str) -> None:
    instance = new()
    instance.set({name: 0.012345678901234567})
    instance.enter()
    assert instance.get(name) == 0.012345678901234567


def test_integers_booleans_and_enumerations(new: Callable[..., Instance]) -> None:
    instance = new()
    values = {"solver.maxIterations": 37, "gravity.enabled": False, "solver.method": 3, "init.assembly": 2}
    instance.set(values)
    instance.enter()
    assert {name: instance.get(name) for name in values} == values


def test_consistent_start(new: Callable[..., Instance]) -> None:
    """Outputs right after initialisation agree with plain geometry."""
    instance = new().initialise()
    assert instance.tip() == pytest.approx((0.21, 0.21), abs=1e-12)
    assert instance.get("elbow[2].x") == pytest.approx(0.42, abs=1e-12)
    assert instance.get("energy.error") == 0.0
    assert instance.get("energy.potential") == pytest.approx(3 * 0.017 * 9.81 * 0.21, rel=1e-12)
    assert abs(instance.get("singular.detJx")) < 1e-9  # distal links in line
    assert instance.get("solver.steps") == 0


def test_der_shares_its_value(new: Callable[..., Instance]) -> None:
    instance = new().initialise({"tau[1]": 0.1, "init.omega[2]": 0.5, "init.theta[2]": 2.0})
    instance.steps(20, 1e-3)
    for i in (1, 2):
        assert instance.get(f"der(theta[{i}])") == instance.get(f"omega[{i}]")
        assert instance.get(f"der(omega[{i}])") == instance.get(f"alpha[{i}]")
