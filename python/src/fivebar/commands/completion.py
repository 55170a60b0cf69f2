"""Shell completion of scenes, variables, columns and methods: types of parameters that accept any text.

Names come from the XML inside the unit. The standard library reads it, because a user waits for the answer after each key.
"""

from typing import TYPE_CHECKING

import click
from click.types import StringParamType

if TYPE_CHECKING:
    from collections.abc import Iterable
    from xml.etree.ElementTree import Element

    from click.shell_completion import CompletionItem


class Scene(StringParamType):
    """The name of a shipped scene, or a file."""

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> "list[CompletionItem]":
        from click.shell_completion import CompletionItem

        from fivebar import shipped

        # Files come first: bash forgets the words before them.
        return [CompletionItem(incomplete, type="file"), *_items(shipped.descriptions(), incomplete)]


class Assignment(StringParamType):
    """`NAME=VALUE`: names of parameters and inputs, and values that have names."""

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> "list[CompletionItem]":
        known = {v.get("name", ""): v for v in _variables(ctx) if v.get("causality") in ("parameter", "input")}
        name, equals, _ = incomplete.partition("=")
        if not equals:
            return _items({f"{each}=": v.get("description", "") for each, v in known.items()}, incomplete)
        return _items({f"{name}={word}": "" for word in _words(ctx, known.get(name))}, incomplete)


class Method(StringParamType):
    """An item of `solver.method`."""

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> "list[CompletionItem]":
        known = {v.get("name"): v for v in _variables(ctx)}
        return _items(_words(ctx, known.get("solver.method")), incomplete)


class Columns(StringParamType):
    """Names or prefixes of columns, separated by commas."""

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> "list[CompletionItem]":
        given, comma, _ = incomplete.rpartition(",")
        computed = [v for v in _variables(ctx) if v.get("causality") in ("output", "local")]
        return _items(
            {
                f"{given}{comma}{v.get('name')}": v.get("description", "")
                for v in computed
                if "derivative" not in v[0].attrib
            },
            incomplete,
        )


def _items(words: "dict[str, str]", incomplete: str) -> "list[CompletionItem]":
    from click.shell_completion import CompletionItem

    return [CompletionItem(word, help=text) for word, text in words.items() if word.startswith(incomplete)]


def _words(ctx: click.Context, variable: "Element | None") -> dict[str, str]:
    """Named values of a variable with their descriptions."""
    if variable is None:
        return {}
    if variable[0].tag == "Boolean":
        return dict.fromkeys(("true", "false"), "")
    declared = variable[0].get("declaredType")
    items = (item for each in _model(ctx, "TypeDefinitions") if each.get("name") == declared for item in each[0])
    return {item.get("name", ""): item.get("description", "") for item in items}


def _variables(ctx: click.Context) -> "Iterable[Element]":
    return _model(ctx, "ModelVariables")


def _model(ctx: click.Context, part: str) -> "Iterable[Element]":
    """A part of the model description of the chosen unit; empty if the unit does not exist."""
    import zipfile
    from xml.etree import ElementTree

    from fivebar import shipped
    from fivebar.errors import FiveBarError

    try:
        with zipfile.ZipFile(ctx.params.get("fmu") or shipped.unit()) as fmu:
            found = ElementTree.fromstring(fmu.read("modelDescription.xml")).find(part)
    except (FiveBarError, OSError, KeyError, zipfile.BadZipFile, ElementTree.ParseError):
        return ()
    return () if found is None else found
