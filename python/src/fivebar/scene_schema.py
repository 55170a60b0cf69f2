"""The JSON Schema of scene files, made from the unit's variables. Editors use it to complete names, show units and mark errors.

It checks each key alone. `fivebar.scene_file` checks combinations of keys, such as a signal and a value of one variable.
"""

import math
from collections.abc import Iterable
from typing import Any

from fivebar import scene_file, signals, tip_scenes
from fivebar.kinematics import SIGN
from fivebar.variables import Variable, Variables

DIALECT = "https://json-schema.org/draft/2020-12/schema"

_LETTERS = r"[^\u0000-\u001f\u007f-\u009f\u2028\u2029\ufffe\uffff]*"

TEXT = {"type": "string", "pattern": rf"^{_LETTERS}\S{_LETTERS}$"}
"""A line of text that is not blank."""

KNOTS = {
    "type": "array",
    "minItems": 2,
    "items": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
}
"""Knots [time in s, value]."""


def schema(variables: Variables) -> dict[str, Any]:
    """Schema of scenes for a unit with these variables."""
    values = {v.name: _value(v) for v in variables.values() if v.can_be_set}
    seconds = {"type": "number", "exclusiveMinimum": 0}
    label = TEXT | {"description": "Name of the run in summary and pictures"}
    overlay = _object({scene_file.LABEL: label} | values, required=[scene_file.LABEL])
    sides = {"enum": list(SIGN)}
    keys = {
        scene_file.SCHEMA: TEXT | {"description": "File or address of this schema, for editors"},
        scene_file.DESCRIPTION: TEXT | {"description": "A sentence for the summary and the page"},
        scene_file.EXPERIMENT: _object(
            {
                "stopTime": seconds | {"description": "Duration of the run, s"},
                "stepSize": seconds | {"description": "Communication step, s", "default": variables.step_size},
            }
        ),
        scene_file.SIGNALS: _object({v.name: _signal(v, variables) for v in variables.values() if signals.may_move(v)}),
        scene_file.OVERLAY: {"type": "array", "items": overlay, "description": "Further runs to compare with"},
        **{
            name: {
                "type": "number",
                "minimum": -math.pi,
                "maximum": math.pi,
                "description": "Encoder reading minus true angle (rad)",
            }
            for name in scene_file.OFFSETS
        },
        **{name: _value(variables[name]) | {"description": "The tip's place at the start (m)"} for name in signals.TIP},
        tip_scenes.WORKING: {
            "type": "array",
            "items": sides,
            "minItems": 2,
            "maxItems": 2,
            "description": "Bends of the left and the right leg, if the start is given by the tip's place",
        },
        tip_scenes.ASSEMBLY: sides
        | {"description": "Side of the tip, if it lies on the line of the elbows at the start"},
    }
    whole = _object(keys | values, required=[scene_file.DESCRIPTION])
    return {"$schema": DIALECT, "title": "Scene of the planar five-bar", **whole, "$defs": {"knots": KNOTS}}


def _value(variable: Variable) -> dict[str, Any]:
    """Schema of a variable's value."""
    unit = "" if variable.unit == "1" else f" ({variable.unit})"
    found: dict[str, Any] = {"description": variable.description + unit}
    if variable.items:
        start = {} if variable.start is None else {"default": variable.item(int(variable.start))}
        return {"enum": list(variable.items), **found, **start}
    bounds = {"minimum": variable.least, "maximum": variable.most, "default": variable.start}
    kind = {"Real": "number", "Integer": "integer", "Boolean": "boolean"}[variable.type]
    return {"type": kind, **found, **{key: bound for key, bound in bounds.items() if bound is not None}}


def _signal(variable: Variable, variables: Variables) -> dict[str, Any]:
    """Schema of a variable's signal."""
    knots = {"$ref": "#/$defs/knots"}
    if variable.causality == "parameter":
        kinds: dict[str, Any] = {signals.STEPS: knots}
    else:
        kinds = dict.fromkeys((signals.LINEAR, signals.MINIMUM_JERK, signals.STEPS), knots)
        sources = [v.name for v in variables.values() if v.causality == "input" and variable.unit == f"{v.unit}/s"]
        if sources:
            kinds[signals.RATE_OF] = {"enum": sources}
    description = _value(variable)["description"]
    return _object(kinds) | {"minProperties": 1, "maxProperties": 1, "description": description}


def _object(properties: dict[str, Any], required: Iterable[str] = ()) -> dict[str, Any]:
    """Schema of an object with exactly these keys."""
    need = {"required": list(required)} if required else {}
    return {"type": "object", "properties": properties, **need, "additionalProperties": False}
