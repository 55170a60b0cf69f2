"""A line on standard error that says how far a command is."""

import sys
from typing import TextIO


class Line:
    """On a terminal each text replaces the one before; elsewhere it is a line of its own."""

    def __init__(self, stream: TextIO | None = None):
        self.stream = stream or sys.stderr
        self.terminal = self.stream.isatty()

    def show(self, text: str) -> None:
        self.stream.write(f"\r\x1b[K{text}" if self.terminal else f"{text}\n")
        self.stream.flush()

    def finish(self) -> None:
        """Clears the line of a terminal."""
        if self.terminal:
            self.stream.write("\r\x1b[K")
            self.stream.flush()
