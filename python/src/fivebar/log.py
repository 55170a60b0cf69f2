"""Messages of the unit: each is stored, and goes to Python's logging."""

import logging
from collections.abc import Callable
from dataclasses import dataclass

from fmpy import fmi2

STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")

logger = logging.getLogger("fivebar.unit")
# Without logging set up, nothing appears on standard error.
logging.getLogger("fivebar").addHandler(logging.NullHandler())


@dataclass(frozen=True)
class Message:
    """One message of a unit."""

    instance: str
    status: int
    """Number of FMI's status: 0 is OK, 1 a warning, more a failed call."""

    category: str
    text: str

    def __str__(self) -> str:
        return f"{STATUS[self.status]}: {self.text}"


def callbacks(keep: Callable[[Message], None]) -> fmi2.fmi2CallbackFunctions:
    """Callbacks of an instance; they must live as long as the instance."""

    def append(_environment: int | None, instance: bytes, status: int, category: bytes, text: bytes) -> None:
        # The standard makes the text a printf format: percent signs are doubled.
        sentence = text.decode(errors="replace").replace("%%", "%")
        keep(Message(instance.decode(errors="replace"), status, category.decode(), sentence))
        # A failed call also raises an exception.
        logger.log(logging.WARNING if status == fmi2.fmi2Warning else logging.DEBUG, "%s", sentence)

    found = fmi2.fmi2CallbackFunctions()
    found.logger = fmi2.fmi2CallbackLoggerTYPE(append)
    found.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
    found.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
    return found
