"""SUNDIALS' CVODE and IDA in C, with headers and libraries of Debian's package libsundials-dev."""

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
    return Peer(
        name, _version(), [_setting(program, method, tolerance) for method in methods for tolerance in TOLERANCES]
    )


def _setting(program: Path, method: str, tolerance: float) -> Setting:
    bare = native.Program(program, method, tolerance, "bare")
    loaded = native.Program(program, method, tolerance, "loaded")
    text = f"{METHODS[method]}, rtol = atol = {tolerance:g}, C by gcc -O3"
    # Only one of the two runs at a time, so the sum is its clock.
    return Setting(text, bare.begin, lambda: bare.clock() + loaded.clock(), loaded.begin)


@functools.cache
def _program() -> Path:
    return native.compiled("sundials.c", "gcc", FLAGS, [*(f"-lsundials_{library}" for library in LIBRARIES), "-lm"])


def _version() -> str:
    header = subprocess.run(
        ["gcc", "-E", "-dM", "-include", "sundials/sundials_config.h", "-"],
        input="",
        capture_output=True,
        text=True,
        check=True,
    )
    return re.search(r'SUNDIALS_VERSION "(.+)"', header.stdout)[1]
