"""A line on standard error with the progress of a command."""

import sys
from typing import TextIO


class Line:
    """A progress line: on a terminal each text replaces the previous one, elsewhere it is a new line."""

    def __init__(self, stream: TextIO | None = None):
        self.stream = stream or sys.stderr
        self.terminal = self.stream.isatty()

    def show(self, text: str) -> None:
        self.stream.write(f"\r\x1b[K{text}" if self.terminal else f"{text}\n")
        self.stream.flush()

    def finish(self) -> None:
        """Clears the line on a terminal."""
        if self.terminal:
            self.stream.write("\r\x1b[K")
            self.stream.flush()
