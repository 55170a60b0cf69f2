"""Pages of the reference, generated from what the code reads: Python's docstrings, the commands, the unit's variables, the shipped scenes, the
schemas of scenes and messages, the example scripts.
"""

import ast
import html
import inspect
import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import click
import fmpy

import fivebar
from fivebar import scene_schema, shipped
from fivebar.colours import LEFT, RIGHT, TIP
from fivebar.commands import COMMANDS
from fivebar.scene import read
from fivebar.variables import Value, Variable, of_unit

REPOSITORY = Path(__file__).parents[3]

MODULES = (
    "inputs",
    "kinematics",
    "statics",
    "workspace",
    "strokes",
    "pieces",
    "paths",
    "path_pictures",
    "simulate",
    "variables",
    "errors",
)
"""Modules that users of the package import, beside the package itself."""


UNITS = "Angles are in rad, lengths in m and times in s unless a name says otherwise."


def pages() -> dict[str, str]:
    """All pages by their place in the site."""
    return {
        **_python(),
        "reference/commands.md": _commands(),
        "reference/variables.md": _variables(),
        "reference/schema.md": _schema(),
        "reference/fivebar.schema.json": json.dumps(scene_schema.schema(of_unit()), indent=2, ensure_ascii=False),
        "reference/messages.md": _messages(),
        "examples.md": _examples(),
        **_scenes(),
    }


def _python() -> dict[str, str]:
    """A page of what `import fivebar` has, and one of the modules."""
    names = sorted(fivebar.__all__, key=lambda name: (name[0].isupper(), name))
    return {
        f"reference/{name}.md": "\n\n".join([f"# {title}", text, *(f"::: fivebar.{each}" for each in members), ""])
        for name, title, text, members in (
            (
                "python",
                "The Python package",
                f"Functions and classes of `import fivebar`. {UNITS} [Modules](modules.md) have more.",
                names,
            ),
            ("modules", "Python modules", f"Modules beside the [package itself](python.md). {UNITS}", MODULES),
        )
    }


def _commands() -> str:
    """The help of each command: its text as it stands, arguments and options as a list."""
    text = [
        "# Commands",
        "",
        "The commands of the wheel, with their options. [CONTRIBUTING](../CONTRIBUTING.md#the-commands) has those of the repository.",
    ]
    for command in COMMANDS:
        context = click.Context(command, info_name=f"fivebar {command.name}")
        text += [
            "",
            f"## fivebar {command.name}",
            "",
            "```sh",
            command.get_usage(context).removeprefix("Usage: "),
            "```",
            "",
            *_help(command.help or ""),
        ]
        for parameter in command.params:
            if isinstance(parameter, click.Option) and (record := parameter.get_help_record(context)):
                text += [f"- `{record[0]}`: {record[1]}"]
    return "\n".join([*text, ""])


def _help(text: str) -> Iterable[str]:
    """Paragraphs of a help text; paragraphs that click must not wrap are commands and become blocks of code."""
    for paragraph in inspect.cleandoc(text).split("\n\n"):
        as_it_stands = paragraph.removeprefix("\b\n")
        yield from [paragraph, ""] if as_it_stands is paragraph else ["```sh", as_it_stands, "```", ""]


def _variables() -> str:
    """Every variable, in groups; `variables.js` filters them."""
    references = {v.name: v.valueReference for v in fmpy.read_model_description(str(shipped.unit())).modelVariables}
    groups: dict[str, list[Variable]] = {}
    for variable in of_unit().values():
        groups.setdefault(re.split(r"[.\[]", variable.name.removeprefix("der("))[0], []).append(variable)
    text = [
        "# Variables",
        f"All {len(references)} variables of `FiveBar.fmu`: name, meaning, start value with unit, bounds, kind, and value reference.",
        (
            '<div class="filter"><label for="filter">Names or words:</label>'
            ' <input id="filter" type="search" placeholder="servo torque" autocomplete="off"><output for="filter"></output></div>'
        ),
    ]
    for name, members in groups.items():
        rows = "\n".join(_row(v, references[v.name]) for v in members)
        text.append(f'## {name}\n\n<div class="variables">\n{rows}\n</div>')
    return "\n\n".join(text) + "\n"


def _row(variable: Variable, reference: int) -> str:
    bounds = [
        f"{sign} {_number(bound)}" for sign, bound in (("≥", variable.least), ("≤", variable.most)) if bound is not None
    ]
    start = "" if variable.start is None else f"{_value(variable, variable.start)}"
    unit = "" if variable.unit == "1" else variable.unit
    items = (
        f" Items: {', '.join(f'{item} ({number})' for item, number in variable.items.items())}."
        if variable.items
        else ""
    )
    kind = (
        variable.causality
        if variable.causality in ("local", "independent")
        else f"{variable.variability} {variable.causality}"
    )
    facts = [
        part
        for part in (
            start and f"{start} {unit}".strip(),
            " ".join(bounds),
            "" if start else unit,
            kind,
            f"#{reference}",
        )
        if part
    ]
    return (
        f'<div class="variable" id="{html.escape(variable.name)}"><code>{html.escape(variable.name)}</code>'
        f"<span>{html.escape(variable.description)}.{html.escape(items)}</span>"
        f"<small>{' · '.join(map(html.escape, facts))}</small></div>"
    )


def _value(variable: Variable, value: Value) -> str:
    if variable.type == "Enumeration":
        return variable.item(int(value))
    return str(value).lower() if variable.type == "Boolean" else _number(value)


def _number(value: float) -> str:
    return repr(value).removesuffix(".0")


def _schema() -> str:
    schema = scene_schema.schema(of_unit())
    values = {v.name for v in of_unit().values() if v.can_be_set}
    keys = {name: entry for name, entry in schema["properties"].items() if name not in values}
    rows = [f"| `{name}` | {_kind(entry)} | {entry.get('description', '')} |" for name, entry in keys.items()]
    return "\n".join(
        [
            "# Schema of scenes",
            "",
            "[`fivebar.schema.json`](fivebar.schema.json) is the JSON Schema of scene files, the same as `fivebar scenes --schema` prints.",
            "Each [variable](variables.md) that can be set is a key, with its value. These keys are no variables:",
            "",
            "| key | type | meaning |",
            "| --- | --- | --- |",
            *rows,
            "",
            "[Scenes](../scenes.md#a-scene-of-your-own) explains them.",
            "",
        ]
    )


def _messages() -> str:
    schema = json.loads((REPOSITORY / "python/src/fivebar/twin/messages.schema.json").read_text(encoding="utf-8"))
    known = schema["definitions"]
    text = [
        "# Messages of the twin",
        "",
        "The [live twin](../pipeline.md) reads and writes these messages over MQTT. The kind is the last part of the topic; the content is JSON. Keys in",
        "bold are required. A message that does not fit is refused, with a sentence in the log.",
    ]
    for kind, entry in known.items():
        if "measurement" not in entry.get("properties", {}):
            continue
        text += ["", f"## {kind}", "", "| key | content |", "| --- | --- |", *_keys(entry, known, "")]
    return "\n".join([*text, ""])


def _keys(entry: Mapping[str, Any], known: Mapping[str, Any], prefix: str) -> Iterable[str]:
    """Rows of the keys of an object, and of objects in it."""
    for name, value in entry.get("properties", {}).items():
        bold = "**" if name in entry.get("required", ()) else ""
        whole = known[value["$ref"].rpartition("/")[2]] if "$ref" in value else value
        text = "; ".join(filter(None, (_kind(whole), whole.get("description", ""))))
        yield f"| {bold}`{prefix}{name}`{bold} | {text} |"
        yield from _keys(whole, known, f"{prefix}{name}.")


def _kind(entry: Mapping[str, Any]) -> str:
    """The values that a schema allows, in words."""
    if "const" in entry:
        return f"`{entry['const']}`"
    if "enum" in entry:
        return "one of " + ", ".join(f"`{item}`" for item in entry["enum"])
    words = entry.get("type", "")
    words = " or ".join(words) if isinstance(words, list) else words
    # The largest double only says that a number is finite.
    bounds = (entry.get("minimum"), entry.get("maximum"))
    low, high = (None if bound is None or abs(bound) >= 1e308 else _number(bound) for bound in bounds)
    if low and high:
        return f"{words}, {low} to {high}"
    return words + (f", at least {low}" if low else f", at most {high}" if high else "")


def _examples() -> str:
    text = [
        "# Examples",
        "",
        "Scripts of `examples/`. The sdist has them too; each runs with `python FILE` where `fivebar` is installed. The tests run all of them.",
    ]
    for file in sorted((REPOSITORY / "examples").glob("*.py")):
        code = file.read_text(encoding="utf-8")
        first = (ast.get_docstring(ast.parse(code)) or "").split("\n\n")[0].replace("\n", " ")
        text += ["", f"## {file.name}", "", first, "", f'??? example "{file.name}"', "", "    ```python"]
        text += [f"    {line}".rstrip() for line in code.splitlines()] + ["    ```"]
    return "\n".join([*text, ""])


def _scenes() -> dict[str, str]:
    """The page of the shipped scenes, and a picture of each."""
    files: dict[str, str] = {}
    text = [
        "# Shipped scenes",
        "",
        "Each picture shows the machine at its start and the path of its tip. The values are those that differ from the [defaults](variables.md).",
    ]
    for name, description in fivebar.scenes().items():
        scene = read(name)
        written = json.loads(shipped.scene_files()[name].read_text(encoding="utf-8"))
        rows = [f"| `{key}` | {_shown(value)} {_unit(key)} |" for key, value in written.items() if key in of_unit()]
        files[f"reference/scenes/{name}.svg"] = _picture(name)
        text += [
            "",
            f"## {name}",
            "",
            description,
            "",
            f"![{name}: the machine at its start, and the path of its tip](scenes/{name}.svg)",
            "",
        ]
        text += [
            f"{scene.stop_time:g} s, in communication steps of {1e3 * scene.step_size:g} ms. `fivebar run {name} --open` runs it."
        ]
        if rows:
            text += ["", "| variable | start value |", "| --- | --- |", *rows]
        if "signals" in written:
            text += ["", f"It moves {', '.join(f'`{key}`' for key in written['signals'])}."]
    return files | {"reference/scenes.md": "\n".join([*text, ""])}


def _shown(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _unit(name: str) -> str:
    return "" if of_unit()[name].unit == "1" else of_unit()[name].unit


def _picture(name: str) -> str:
    """Posture at the start and path of the tip, without a background: it is seen on light and on dark pages."""
    run = fivebar.run(name, outputs=["tip", "elbow"], stop_time=min(read(name).stop_time, 10.0))
    distance = float(read(name)["base.distance"])
    chain = [
        (0.0, 0.0),
        *((float(run[f"{at}.x"][0]), float(run[f"{at}.y"][0])) for at in ("elbow[1]", "tip", "elbow[2]")),
        (distance, 0.0),
    ]
    every = max(1, len(run["tip.x"]) // 400)
    path = list(zip(run["tip.x"][::every], run["tip.y"][::every], strict=True))
    xs, ys = zip(*chain, *path, strict=True)
    size = 240 / max(max(xs) - min(xs), max(ys) - min(ys))

    def points(way: Iterable[tuple[float, float]]) -> str:
        return " ".join(f"{(x - min(xs)) * size + 12:.1f},{(max(ys) - y) * size + 12:.1f}" for x, y in way)

    joints = "".join('<circle cx="{}" cy="{}" r="4"/>'.format(*points([joint]).split(",")) for joint in chain)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {(max(xs) - min(xs)) * size + 24:.0f} {(max(ys) - min(ys)) * size + 24:.0f}"'
        ' fill="none" stroke-linecap="round" stroke-linejoin="round">'
        f'<polyline points="{points(path)}" stroke="{TIP}" stroke-width="1.5"/>'
        f'<polyline points="{points(chain[:3])}" stroke="{LEFT}" stroke-width="4"/>'
        f'<polyline points="{points(chain[2:])}" stroke="{RIGHT}" stroke-width="4"/>'
        f'<g fill="#8a8f98">{joints}</g></svg>\n'
    )
