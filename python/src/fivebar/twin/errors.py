"""User errors: one sentence with the name, its value and the allowed values."""

from fivebar.errors import FiveBarError


class TwinError(FiveBarError):
    """An error that the user can fix: a file, a setting, a broker."""


class Refused(TwinError):
    """A rejected message; the text is the reason."""
