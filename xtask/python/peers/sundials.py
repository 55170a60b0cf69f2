"""SUNDIALS' CVODE and IDA in C; headers and libraries are those of Debian's package libsundials-dev."""

import functools
import re
import subprocess
from pathlib import Path

import native
from machine import Peer, Setting

FLAGS = ["-std=c11", "-D_POSIX_C_SOURCE=199309L", "-O3", "-march=native"]
LIBRARIES = ("cvode", "ida", "nvecserial", "sunlinsoldense", "sunmatrixdense", "sunnonlinsolfixedpoint")
TOLERANCES = tuple(10.0**-n for n in range(3, 15))
METHODS = {
    "adams": "Adams with functional iteration, 4 angles",
    "bdf": "BDF with Newton and a dense matrix by differences, 4 angles",
    "ida": "BDF, index 1, 4 angles and 2 multipliers, which do not steer the step",
}


def cvode() -> Peer:
    return _peer("SUNDIALS CVODE", ("adams", "bdf"))


def ida() -> Peer:
    return _peer("SUNDIALS IDA", ("ida",))


def _peer(name: str, methods: tuple[str, ...]) -> Peer:
    program = _program()
    runs = [(method, tolerance, native.Program(program, method, tolerance)) for method in methods for tolerance in TOLERANCES]
    settings = [Setting(f"{METHODS[m]}, rtol = atol = {x:g}, C by gcc -O3", run.begin, run.clock) for m, x, run in runs]
    return Peer(name, _version(), settings)


@functools.cache
def _program() -> Path:
    """One for both."""
    return native.compiled("sundials.c", "gcc", FLAGS, [*(f"-lsundials_{library}" for library in LIBRARIES), "-lm"])


def _version() -> str:
    header = subprocess.run(["gcc", "-E", "-dM", "-include", "sundials/sundials_config.h", "-"], input="", capture_output=True, text=True)
    return re.search(r'SUNDIALS_VERSION "(.+)"', header.stdout)[1]
