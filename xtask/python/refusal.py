"""The one error for a scene that cannot be run, and what its sentences are made from."""

import difflib
import math
from typing import Any


class SceneError(ValueError):
    """A scene that cannot be run; the text is one sentence naming the file, the key and what is allowed."""


def is_number(value: Any) -> bool:
    """Whether a value from JSON is a finite number; `true` is none."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def similar(name: str, candidates: tuple[str, ...]) -> str:
    """The end of a sentence about an unknown `name`: those it may have been meant to be."""
    matches = difflib.get_close_matches(name, candidates, n=3, cutoff=0.6)
    if matches:
        return f"; did you mean {' or '.join(repr(match) for match in matches)}?"
    return "; known: " + ", ".join(candidates[:6]) + (f" and {len(candidates) - 6} more." if len(candidates) > 6 else ".")
