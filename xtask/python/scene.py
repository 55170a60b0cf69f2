"""Scenes: flat JSON files that map variable names of the FMU to start values, checked against its model description.

Reserved keys are `description` (text), `experiment` ({"stopTime", "stepSize"}, the communication step, in s), `signals`
(inputs that change with time: see signals.py) and `overlay` (further runs for comparison: each a `label` and the values that
replace the scene's; the signals are the same).
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fmpy.model_description import ModelDescription, ScalarVariable

import signals
from refusal import SceneError, is_number, similar
from signals import Signal

RESERVED = ("description", "experiment", "signals", "overlay")
EXPERIMENT = ("stopTime", "stepSize")

Values = dict[str, float | int | bool]


@dataclass(frozen=True)
class Variant:
    """One run of a scene: a label for the pictures and the start values (enumerations already as integers)."""

    label: str
    values: Values


@dataclass(frozen=True)
class Scene:
    """A scene that has been checked. `variants[0]` is the scene itself, the others are its overlays."""

    name: str
    description: str
    stop_time: float
    step_size: float
    variants: list[Variant] = field(default_factory=list)
    signals: dict[str, Signal] = field(default_factory=dict)


def read(path: Path, model: ModelDescription) -> Scene:
    """Reads the scene at `path`; every key and value must be one that `model` knows."""
    where = path.name
    content = _load(path, where)
    variables = {v.name: v for v in model.modelVariables if v.causality in ("parameter", "input")}
    known = {v.name: v for v in model.modelVariables}
    stop_time, step_size = _experiment(where, content.get("experiment", {}), model)
    own = {k: v for k, v in content.items() if k not in RESERVED}
    values = _values(where, own, variables, known, RESERVED)
    variants = [Variant(_method_label(values, variables), values)]
    for number, item in enumerate(_list(where, content.get("overlay", [])), start=1):
        variants.append(_overlay(f"{where}, overlay {number}", item, own, variables, known))
    inputs = {v.name: v for v in model.modelVariables if v.causality == "input"}
    given = signals.read(where, content.get("signals", {}), inputs, unit)
    for name in given:
        if any(name in variant.values for variant in variants):
            raise SceneError(f"{where}: '{name}' is given a signal and a value; only one of them can hold.")
    labels = [variant.label for variant in variants]
    for label in labels:
        if labels.count(label) > 1:
            raise SceneError(f"{where}: two runs have the label '{label}'; labels must differ.")
    description = _text(where, "description", content.get("description", ""))
    return Scene(path.stem, description, stop_time, step_size, variants, given)


def unit(variable: ScalarVariable) -> str:
    """The unit of a variable, "1" if it has none."""
    return variable.unit or getattr(variable.declaredType, "unit", None) or "1"


def _load(path: Path, where: str) -> dict[str, Any]:
    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = [key for key, _ in pairs]
        for key in keys:
            if keys.count(key) > 1:
                raise SceneError(f"{where}: '{key}' is given twice.")
        return dict(pairs)

    try:
        content = json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=unique)
    except FileNotFoundError:
        scenes = ", ".join(sorted(p.stem for p in path.parent.glob("*.json"))) or "none"
        raise SceneError(f"There is no scene '{path.stem}'; the scenes beside it are: {scenes}.") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{where} is not valid JSON: {error}.") from None
    if not isinstance(content, dict):
        raise SceneError(f"{where}: a scene is an object of variable names and values, not a {type(content).__name__}.")
    return content


def _experiment(where: str, given: Any, model: ModelDescription) -> tuple[float, float]:
    if not isinstance(given, dict):
        raise SceneError(f'{where}: \'experiment\' must be an object such as {{"stopTime": 2, "stepSize": 0.001}}.')
    for key in given:
        if key not in EXPERIMENT:
            raise SceneError(f"{where}: 'experiment' has no key '{key}'{similar(key, EXPERIMENT)}")
    default = model.defaultExperiment
    numbers = []
    for key in EXPERIMENT:
        number = given[key] if key in given else float(getattr(default, key))
        if not (is_number(number) and number > 0):
            raise SceneError(f"{where}: 'experiment.{key}' must be a positive number of seconds, not {json.dumps(number)}.")
        numbers.append(float(number))
    return numbers[0], numbers[1]


def _overlay(
    where: str, item: Any, own: dict[str, Any], variables: dict[str, ScalarVariable], known: dict[str, ScalarVariable]
) -> Variant:
    if not isinstance(item, dict) or "label" not in item:
        raise SceneError(f"{where}: an overlay is an object with a 'label' and the values that replace the scene's.")
    label = _text(where, "label", item["label"])
    changes = {k: v for k, v in item.items() if k != "label"}
    _values(where, changes, variables, known, ("label",))
    return Variant(label, _values(where, own | changes, variables, known, RESERVED))


def _values(
    where: str,
    given: dict[str, Any],
    variables: dict[str, ScalarVariable],
    known: dict[str, ScalarVariable],
    reserved: tuple[str, ...],
) -> Values:
    values: Values = {}
    for name, value in given.items():
        if name in known and name not in variables:
            raise SceneError(f"{where}: '{name}' is computed by the FMU ({known[name].causality}) and cannot be set.")
        if name not in variables:
            raise SceneError(f"{where}: there is no variable '{name}'{similar(name, (*variables, *reserved))}")
        values[name] = _value(where, variables[name], value)
    return values


def _value(where: str, variable: ScalarVariable, value: Any) -> float | int | bool:
    """`value` as fmi2Set… of the variable's type wants it."""
    wanted: str
    match variable.type:
        case "Real":
            if is_number(value):
                return float(value)
            wanted = f"a finite number in {unit(variable)}"
        case "Integer":
            if isinstance(value, int) and not isinstance(value, bool):
                return value
            wanted = "a whole number"
        case "Boolean":
            if isinstance(value, bool):
                return value
            wanted = "true or false"
        case _:
            items = {item.name: int(item.value) for item in variable.declaredType.items}
            if isinstance(value, str) and value in items:
                return items[value]
            wanted = "one of " + ", ".join(items)
    raise SceneError(f"{where}: '{variable.name}' must be {wanted}, not {json.dumps(value)}.")


def _method_label(values: Values, variables: dict[str, ScalarVariable]) -> str:
    """The method's name in the FMU's enumeration."""
    method = variables["solver.method"]
    number = int(values.get("solver.method", method.start))
    return next(item.name for item in method.declaredType.items if int(item.value) == number)


def _list(where: str, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise SceneError(f"{where}: 'overlay' must be a list of runs.")
    return value


def _text(where: str, key: str, value: Any) -> str:
    if not isinstance(value, str) or (key == "label" and not value.strip()):
        raise SceneError(f"{where}: '{key}' must be a text, not {json.dumps(value)}.")
    return value
