"""The packed .fmu and its model description: FMPy's checks, and further rules that validators miss."""

import copy
import graphlib
import math
import re
import zipfile
from collections import Counter
from pathlib import Path

import fmpy.validation
import pytest
from lxml import etree

# FMI 2.0.4, section 2.2.9: names with dots and indices, and der() of such a name.
STRUCTURED_NAME = re.compile(r"(der\()?[A-Za-z_]\w*(\[\d+\])?(\.[A-Za-z_]\w*(\[\d+\])?)*(?(1)\))")

TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")


@pytest.fixture(scope="module")
def root(fmu: Path) -> etree._Element:
    """Root of modelDescription.xml in the .fmu."""
    with zipfile.ZipFile(fmu) as archive:
        return etree.fromstring(archive.read("modelDescription.xml"))


@pytest.fixture(scope="module")
def variables(root: etree._Element) -> list[etree._Element]:
    """All ScalarVariable elements."""
    return root.findall("ModelVariables/ScalarVariable")


def value_element(variable: etree._Element) -> etree._Element:
    """The Real, Integer, ... of a variable."""
    return next(child for child in variable if child.tag in TYPES)


def simple_type(root: etree._Element, name: str) -> etree._Element:
    """The Real, Integer, ... of the type definition `name`."""
    (found,) = [t for t in root.findall("TypeDefinitions/SimpleType") if t.get("name") == name]
    return value_element(found)


def attribute(root: etree._Element, variable: etree._Element, name: str) -> str | None:
    """An attribute of a variable, or of its type if it has none itself."""
    own = value_element(variable)
    if own.get(name) is None and own.get("declaredType") is not None:
        return simple_type(root, own.get("declaredType")).get(name)
    return own.get(name)


def test_fmpy_finds_no_problem(fmu: Path) -> None:
    assert fmpy.validation.validate_fmu(str(fmu)) == []


def test_archive(fmu: Path) -> None:
    with zipfile.ZipFile(fmu) as archive:
        assert archive.testzip() is None
        names = archive.namelist()
        text = archive.read("modelDescription.xml").decode("utf-8")
        assert {item.compress_type for item in archive.infolist()} <= {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
    assert not [name for name in names if "\\" in name or name.startswith("/") or ".." in name]
    assert len(names) == len(set(names))
    assert text.startswith('<?xml version="1.0" encoding="UTF-8"?>')
    for needed in ("documentation/index.html", "model.png"):
        assert needed in names
    assert any(name.startswith(("licenses/", "documentation/licenses/")) for name in names)


def test_head(root: etree._Element) -> None:
    for name in (
        "guid",
        "version",
        "author",
        "copyright",
        "license",
        "generationTool",
        "generationDateAndTime",
        "description",
    ):
        assert root.get(name), f"{name} is empty"
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", root.get("generationDateAndTime"))
    assert root.get("modelName") == root.find("CoSimulation").get("modelIdentifier") == "FiveBar"
    exchange, simulation = root.find("ModelExchange"), root.find("CoSimulation")
    assert exchange.get("modelIdentifier") == simulation.get("modelIdentifier")
    assert all(
        root.find(kind).get("providesDirectionalDerivative") == "true" for kind in ("ModelExchange", "CoSimulation")
    )


def test_names_and_references(variables: list[etree._Element]) -> None:
    names = [v.get("name") for v in variables]
    assert len(names) == len(set(names))
    assert all(v.get("description") for v in variables)
    assert all(STRUCTURED_NAME.fullmatch(name) for name in names)
    states = {i: v.get("name") for i, v in enumerate(variables, start=1)}
    for variable in variables:
        derivative = value_element(variable).get("derivative")
        assert variable.get("name").startswith("der(") == (derivative is not None)
        assert derivative is None or variable.get("name") == f"der({states[int(derivative)]})"
    outside_derivatives = [v for v in variables if not v.get("name").startswith("der(")]
    keys = [(value_element(v).tag, v.get("valueReference")) for v in outside_derivatives]
    assert len(keys) == len(set(keys)), "two variables share a reference"


def test_type_names_differ_from_variable_names(root: etree._Element, variables: list[etree._Element]) -> None:
    assert {t.get("name") for t in root.findall("TypeDefinitions/SimpleType")}.isdisjoint(
        v.get("name") for v in variables
    )


def test_starts_and_bounds(root: etree._Element, variables: list[etree._Element]) -> None:
    for variable in variables:
        name, own = variable.get("name"), value_element(variable)
        if variable.get("causality") in ("parameter", "input"):
            assert own.get("start") is not None, f"{name} has no start"
        else:
            assert own.get("start") is None, f"{name} is calculated and has a start"
        if own.tag not in ("Real", "Integer"):
            continue
        low, high, start, nominal = (attribute(root, variable, key) for key in ("min", "max", "start", "nominal"))
        low, high = float(low or -math.inf), float(high or math.inf)
        assert low <= high, f"{name}: min > max"
        assert start is None or (math.isfinite(float(start)) and low <= float(start) <= high), (
            f"{name}: start outside min and max"
        )
        assert nominal is None or float(nominal) > 0, f"{name}: nominal"


def test_causality_and_variability(variables: list[etree._Element]) -> None:
    allowed = {
        "parameter": {("fixed", "exact"), ("tunable", "exact")},
        "input": {("continuous", None), ("discrete", None)},
        "output": {("continuous", "calculated"), ("discrete", "calculated")},
        "local": {("continuous", "calculated"), ("discrete", "calculated")},
    }
    for variable in variables:
        assert variable.get("causality") != "output" or value_element(variable).tag == "Real", variable.get("name")
        assert (variable.get("variability"), variable.get("initial")) in allowed[variable.get("causality")], (
            variable.get("name")
        )
        if value_element(variable).tag != "Real":
            assert variable.get("variability") != "continuous", variable.get("name")


def test_types(root: etree._Element, variables: list[etree._Element]) -> None:
    for variable in variables:
        own = value_element(variable)
        if own.get("declaredType") is not None:
            assert simple_type(root, own.get("declaredType")).tag == own.tag, variable.get("name")


def exponents(unit: str) -> dict[str, int]:
    """Exponents of the base units in the name of a unit such as N.m.s/rad."""
    derived = {"N": {"kg": 1, "m": 1, "s": -2}, "J": {"kg": 1, "m": 2, "s": -2}}
    result: Counter[str] = Counter()
    for sign, part in zip((1, -1), unit.split("/"), strict=False):
        for name, power in re.findall(r"([A-Za-z]+)(\d*)", part):
            for base, exponent in derived.get(name, {name: 1}).items():
                result[base] += sign * exponent * int(power or 1)
    return {base: exponent for base, exponent in result.items() if exponent != 0}


def test_exponents_of_units(root: etree._Element) -> None:
    for unit in root.findall("UnitDefinitions/Unit"):
        declared = {base: int(exponent) for base, exponent in unit.find("BaseUnit").attrib.items()}
        assert declared == exponents(unit.get("name")), unit.get("name")
        assert [d.get("factor") for d in unit.iter("DisplayUnit")] in ([], [repr(180 / math.pi)]), unit.get("name")


def test_units(root: etree._Element, variables: list[etree._Element]) -> None:
    units = {
        u.get("name"): [d.get("name") for d in u.iter("DisplayUnit")] for u in root.findall("UnitDefinitions/Unit")
    }
    for variable in variables:
        if value_element(variable).tag == "Real":
            unit = attribute(root, variable, "unit")
            assert unit in units, f"{variable.get('name')}: unit {unit} is not defined"
            display = attribute(root, variable, "displayUnit")
            assert display is None or display in units[unit]
            assert attribute(root, variable, "quantity"), f"{variable.get('name')} has no quantity"


def test_enumerations(root: etree._Element, variables: list[etree._Element]) -> None:
    for variable in variables:
        own = value_element(variable)
        if own.tag == "Enumeration":
            items = simple_type(root, own.get("declaredType")).findall("Item")
            assert len({i.get("name") for i in items}) == len({i.get("value") for i in items}) == len(items)
            assert own.get("start") is None or own.get("start") in {i.get("value") for i in items}


def test_structure(root: etree._Element, variables: list[etree._Element]) -> None:
    structure = root.find("ModelStructure")
    outputs = [i for i, v in enumerate(variables, start=1) if v.get("causality") == "output"]
    assert [int(u.get("index")) for u in structure.findall("Outputs/Unknown")] == outputs
    derivatives = {
        i: int(value_element(v).get("derivative"))
        for i, v in enumerate(variables, 1)
        if value_element(v).get("derivative")
    }
    assert [int(u.get("index")) for u in structure.findall("Derivatives/Unknown")] == sorted(derivatives)
    # Every calculated output, continuous state and derivative is an initial unknown, exactly once.
    initial = [int(u.get("index")) for u in structure.findall("InitialUnknowns/Unknown")]
    assert sorted(initial) == sorted({*outputs, *derivatives, *derivatives.values()})
    inputs = {i for i, v in enumerate(variables, 1) if v.get("causality") == "input"}
    running = inputs | set(derivatives.values())
    # FMI 2.0.4, section 2.2.8: at the start, variables with initial = exact are known.
    starting = inputs | {i for i, v in enumerate(variables, 1) if v.get("initial") == "exact"}
    for section, known in (("Outputs", running), ("Derivatives", running), ("InitialUnknowns", starting)):
        for unknown in structure.findall(f"{section}/Unknown"):
            dependencies = [int(d) for d in unknown.get("dependencies", "").split()]
            assert unknown.get("dependencies") is not None, "no declaration means: depends on everything"
            assert set(dependencies) <= known and dependencies == sorted(set(dependencies))
            kinds = unknown.get("dependenciesKind")
            assert kinds is None or len(kinds.split()) == len(dependencies)


def test_outputs_are_the_variables_that_masters_connect(variables: list[etree._Element]) -> None:
    """In this order; all other computed variables are local."""
    motion = ["tip.x", "tip.y", "tip.vx", "tip.vy", "theta[1]", "theta[2]", "omega[1]", "omega[2]"]
    forces = ["servo.torque[1]", "servo.torque[2]", "contact.fx", "contact.fy"]
    estimated = ["estimated.tau[1]", "estimated.tau[2]", "estimated.nis", "estimated.alarm"]
    assert [v.get("name") for v in variables if v.get("causality") == "output"] == motion + forces + estimated


class Loop(Exception):
    """An algebraic loop, with the variables on it."""


def order_of_evaluation(
    root: etree._Element, units: list[str], section: str, wires: list[tuple[str, str]]
) -> list[str]:
    """The order in which a master can compute coupled units; raises `Loop` if there is none. OMSimulator's rule: every unknown of the section
    comes after its dependencies, or after all inputs if none are declared; every input comes after its connected output."""
    names = [v.get("name") for v in root.findall("ModelVariables/ScalarVariable")]
    inputs = [v.get("name") for v in root.findall("ModelVariables/ScalarVariable") if v.get("causality") == "input"]
    after: dict[str, set[str]] = {}
    for unit in units:
        for unknown in root.findall(f"ModelStructure/{section}/Unknown"):
            declared = unknown.get("dependencies")
            needed = inputs if declared is None else [names[int(i) - 1] for i in declared.split()]
            mine = names[int(unknown.get("index")) - 1]
            # A state listed as its own dependency is no loop: it is known.
            after[f"{unit}.{mine}"] = {f"{unit}.{name}" for name in needed if name != mine}
    for source, sink in wires:
        after.setdefault(sink, set()).add(source)
    try:
        return list(graphlib.TopologicalSorter(after).static_order())
    except graphlib.CycleError as error:
        raise Loop(error.args[1]) from None


@pytest.mark.parametrize("section", ["Outputs", "InitialUnknowns"])
def test_units_coupled_through_their_tips_form_no_loop(root: etree._Element, section: str) -> None:
    """Tip, angles and rates of each determine forces and setpoints of the other: there is no loop, neither at the start nor during the run.
    Torques of servos that follow each other form a loop, and without dependencies everything would."""

    def both_ways(*pairs: tuple[str, str]) -> list[tuple[str, str]]:
        return [(f"{a}.{source}", f"{b}.{sink}") for a, b in (("one", "two"), ("two", "one")) for source, sink in pairs]

    motion = both_ways(
        ("tip.x", "tip.fx"),
        ("tip.vy", "tip.fy"),
        ("theta[1]", "servo.theta[1]"),
        ("omega[2]", "servo.omega[2]"),
        ("contact.fx", "tau[1]"),
    )
    assert order_of_evaluation(root, ["one", "two"], section, motion)
    with pytest.raises(Loop, match="servo.torque"):
        order_of_evaluation(root, ["one", "two"], section, both_ways(("servo.torque[1]", "servo.theta[1]")))
    bare = copy.deepcopy(root)
    for unknown in bare.iter("Unknown"):
        del unknown.attrib["dependencies"]
    with pytest.raises(Loop):
        order_of_evaluation(bare, ["one", "two"], section, motion)


def test_log_categories(root: etree._Element) -> None:
    declared = {c.get("name") for c in root.findall("LogCategories/Category")}
    assert declared == {
        "logEvents",
        "logStatusWarning",
        "logStatusDiscard",
        "logStatusError",
        "logStatusFatal",
        "logAll",
    }
