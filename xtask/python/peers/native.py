"""Peers that are programs: compiled from xtask/peers, one process per run; each reports its own time.

A program reads times from its input, one per line. For each it prints the processor time spent so far on advancing, s, and the state there:
four angles and four rates. Its time thus includes neither Python nor the pipe.
"""

import os
import select
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np

REPOSITORY = Path(__file__).resolve().parents[3]
SOURCES = REPOSITORY / "xtask" / "peers"
BUILT = REPOSITORY / "target" / "peers"

# Processor time, s, after which a run ends at the next whole simulated second. A separate program also ends if it has not answered for
# this long.
BUDGET = 10
TOO_LONG = f"takes longer than {BUDGET} s"


class CannotBuild(Exception):
    """A compiler or library is missing; carries its message."""


def compiled(source: str, compiler: str, flags: list[str], libraries: list[str]) -> Path:
    """Program compiled from a file of xtask/peers by gcc or g++."""
    program = BUILT / f"peer-{Path(source).stem}"
    _build([compiler, *flags, str(SOURCES / source), "-o", str(program), *libraries])
    return program


def cargo_built(folder: str) -> Path:
    """Program built from a crate of xtask/peers, which is not part of the workspace."""
    target = BUILT / folder
    manifest = SOURCES / folder / "Cargo.toml"
    cargo = os.environ.get("CARGO", "cargo")
    _build(
        [
            cargo,
            "build",
            "--release",
            "--locked",
            "--quiet",
            "--manifest-path",
            str(manifest),
            "--target-dir",
            str(target),
        ]
    )
    return target / "release" / f"peer-{folder}"


def _build(command: list[str]) -> None:
    print(f"building: {' '.join(command).replace(f'{REPOSITORY}{os.sep}', '')}", flush=True)
    BUILT.mkdir(parents=True, exist_ok=True)
    try:
        outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise CannotBuild(f"{command[0]}: {error.strerror}") from None
    if outcome.returncode:
        errors = [line.strip() for line in outcome.stderr.splitlines() if "error" in line]
        raise CannotBuild(f"{command[0]}: {errors[0] if errors else 'failed'}".replace(f"{REPOSITORY}{os.sep}", ""))


class Program:
    """A program with its arguments; the start angles follow them."""

    def __init__(self, *command: object) -> None:
        self.command = [str(word) for word in command]
        self.spent = 0.0

    def clock(self) -> float:
        """Processor time of the last run, s, as last reported."""
        return self.spent

    def begin(self, start: np.ndarray) -> Callable[[float], np.ndarray]:
        """Starts a run from angles at rest; the process ends with the returned function."""
        run = _Run([*self.command, *(repr(float(angle)) for angle in start[:4])])
        self.spent = 0.0

        def advance(until: float) -> np.ndarray:
            self.spent, *state = run.ask(until)
            return np.array(state)

        return advance


class _Run:
    def __init__(self, command: list[str]) -> None:
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)

    def ask(self, until: float) -> list[float]:
        try:
            self.process.stdin.write(f"{until!r}\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # its last output gives the reason
        # A solver may hang in steps of zero length. (A CPU limit of the process would coarsen its clock to the system's tick.)
        if not select.select([self.process.stdout], [], [], BUDGET)[0]:
            self.process.kill()
            raise RuntimeError(TOO_LONG)
        answer = self.process.stdout.readline().split()
        if len(answer) != 9:
            self.process.wait()
            last = self.process.stderr.read().strip().splitlines()
            raise RuntimeError(last[-1] if last else "the program ended without a word")
        return [float(number) for number in answer]

    def __del__(self) -> None:
        self.process.kill()
        self.process.communicate()
