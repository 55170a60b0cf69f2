"""Errors and warnings that the caller can fix: one sentence names the object, its value and the allowed values."""

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
    """A scene describes a machine that cannot exist, or a column of a record is probably misspelt. The command prints the message and continues."""
