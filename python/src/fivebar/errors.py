"""Errors and warnings that the caller can mend: one sentence that names the object, its value, and the allowed ones."""


class FiveBarError(ValueError):
    """A file, a name, a value or a setting that is refused; the command prints it and ends with exit code 2."""


class MachineWarning(UserWarning):
    """A machine that cannot be as its scene says; the command prints it and goes on."""
