"""Errors and warnings that the caller can mend: one sentence that names the object, its value, and the allowed ones."""

from typing import Any


class FiveBarError(ValueError):
    """A file, a name, a value or a setting that is refused; the command prints it and ends with exit code 2."""


class UnitError(FiveBarError):
    """The unit refused a call; the text is its own sentence."""


class StepFailed(UnitError):
    """A step that the unit could not do: it is discarded, and the unit is as before it."""

    result: Any = None
    """Of a run: what was computed before that step."""


class MachineWarning(UserWarning):
    """A machine that cannot be as its scene says; the command prints it and goes on."""
