"""Pinocchio's constrained dynamics in C++, integrated by Boost.Odeint, because Pinocchio has no integrator."""

import importlib.metadata
from importlib.util import find_spec
from pathlib import Path

import native
from machine import Peer, Setting

# Definitions from Pinocchio's own CMake files. Its functions come compiled from its library; compiling them here for this processor is not
# faster.
DEFINITIONS = (
    "BOOST_FUSION_INVOKE_MAX_ARITY=12",
    "BOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "BOOST_MPL_LIMIT_LIST_SIZE=30",
    "BOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "NDEBUG",
    "PINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION",
)
FLAGS = ["-std=c++17", "-O3", *(f"-D{name}" for name in DEFINITIONS)]
METHODS = {"rk4": "RK4, h = {:g} s", "rkf78": "Runge-Kutta-Fehlberg 7(8), tolerance {:g}"}
# Baumgarte's gains (1/s^2, 1/s): none, or critically damped.
GAINS = ((0, 0), (1e2, 2e1), (1e4, 2e2))
RUNS = tuple(("rk4", h) for h in (2e-3, 1e-3, 1e-4)) + tuple(("rkf78", 10.0**-n) for n in range(4, 14))


def peer() -> Peer:
    prefix = _prefix()
    headers = [flag for folder in ("include", "include/eigen3") for flag in ("-isystem", str(prefix / folder))]
    libraries = [f"-L{prefix / 'lib'}", "-lpinocchio_default", f"-Wl,-rpath,{prefix / 'lib'}"]
    program = native.compiled("pinocchio.cpp", "g++", FLAGS + headers, libraries)
    runs = [(*run, *gains) for gains in GAINS for run in RUNS]
    return Peer(
        "Pinocchio",
        importlib.metadata.version("libpinocchio"),
        [_setting(native.Program(program, *run), *run) for run in runs],
    )


def _prefix() -> Path:
    """Folder of the package's headers and libraries."""
    cmeel = find_spec("cmeel")
    if cmeel is None:
        raise ImportError("No module named 'cmeel'")
    return Path(cmeel.origin).parent.parent / "cmeel.prefix"


def _setting(program: native.Program, method: str, knob: float, kp: float, kd: float) -> Setting:
    gains = f"Baumgarte {kp:g} 1/s^2, {kd:g} 1/s" if kp else "no Baumgarte"
    text = (
        f"constraintDynamics (proximal, mu 1e-12, 1 iteration), {METHODS[method].format(knob)}, {gains}, C++ by g++ -O3"
    )
    return Setting(text, program.begin, program.clock)
