"""Errors on the user's side: one sentence that names the object, its value, and the allowed ones."""

from fivebar.errors import FiveBarError


class TwinError(FiveBarError):
    """Something that the caller can mend: a file, a setting, a broker."""


class Refused(TwinError):
    """A message that is not taken; the text says why."""
