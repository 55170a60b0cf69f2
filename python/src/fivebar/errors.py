"""Errors and warnings that the caller can fix: one sentence names the object, its value and the allowed values."""

import os
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fivebar.result import Result


class FiveBarError(ValueError):
    """A file, a name, a value or a setting was refused. The command prints the message and ends with exit code 2."""


class UnitError(FiveBarError):
    """The unit refused a call; the text is the unit's message."""


class StepFailed(UnitError):
    """A step failed. The unit discards the step and keeps its state before it.

    `result` has the run up to the failure, or is None outside a run.

    Examples
    --------
    >>> import fivebar
    >>> hopeless = {"tau[1]": 50, "solver.adaptive": False, "solver.maxIterations": 3}
    >>> try:
    ...     fivebar.run("swing", **hopeless)
    ... except fivebar.StepFailed as failure:
    ...     print(failure.result.time[-1] < 0.1)
    True
    """

    def __init__(self, sentence: str, result: "Result | None" = None):
        super().__init__(sentence)
        self.result = result


class MachineWarning(UserWarning):
    """Values describe an impossible machine or are hardly meant: degrees for rad, a misspelt column. The command prints the message and continues."""


def warn(sentence: str) -> None:
    """Gives a MachineWarning at the caller's line, which is the nearest one outside of this package."""
    package, level, frame = f"{Path(__file__).parent}{os.sep}", 1, sys._getframe()
    while frame.f_back is not None and frame.f_code.co_filename.startswith(package):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, MachineWarning, stacklevel=level)
