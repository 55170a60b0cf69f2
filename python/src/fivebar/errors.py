"""Errors and warnings that the caller can mend: one sentence that names the object, its value, and the allowed ones."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fivebar.result import Result


class FiveBarError(ValueError):
    """A file, a name, a value or a setting that is refused; the command prints it and ends with exit code 2."""


class UnitError(FiveBarError):
    """The unit refused a call; the text is its own sentence."""


class StepFailed(UnitError):
    """A step that the unit could not make: it is discarded, and the unit is as before. `result` is that of the run up to then, if there is a run.

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
    """A machine that cannot be as its scene says; the command prints it and goes on."""
