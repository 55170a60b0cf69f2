"""Reads text files of users: UTF-8 with or without a byte order mark, or UTF-16 with one, as editors and spreadsheets write them."""

from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from pathlib import Path

from fivebar.errors import FiveBarError

ALLOWED = "text in UTF-8, or in UTF-16 with a byte order mark, is allowed"


def content(file: Path, largest: int) -> bytes:
    """The bytes of a file of limited size. Raises FiveBarError, for example "it cannot be read"."""
    try:
        with file.open("rb") as stream:
            found = stream.read(largest + 1)
    except OSError as error:
        raise FiveBarError(f"it cannot be read: {error.strerror}") from None
    if len(found) > largest:
        raise FiveBarError(f"it has more than {largest} bytes")
    return found


def decoded(given: bytes) -> str:
    """The text in these bytes, without a byte order mark."""
    encoding = "utf-16" if given.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "utf-8-sig"
    try:
        text = given.decode(encoding)
    except UnicodeDecodeError as error:
        name = "UTF-16" if encoding == "utf-16" else "UTF-8"
        raise FiveBarError(f"it cannot be read: it is not valid {name} at byte {error.start}; {ALLOWED}") from None
    if "\0" in text:
        raise FiveBarError(f"it cannot be read: it has the character 0, which no text has; {ALLOWED}")
    return text


def read(file: Path, largest: int) -> str:
    """The text of a file of limited size."""
    return decoded(content(file, largest))
