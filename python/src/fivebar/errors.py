"""What the caller can mend: each error is one sentence that names what, its value, and what is allowed."""


class FiveBarError(ValueError):
    """A file, a name, a value or a setting that is refused; the command prints it and ends with exit code 2."""
