"""What can go wrong on the user's side: each is one sentence that names what, its value, and what is allowed."""


class TwinError(Exception):
    """Something that the caller can mend: a file, a setting, a broker."""


class Refused(TwinError):
    """A message that is not taken; the text says why."""
