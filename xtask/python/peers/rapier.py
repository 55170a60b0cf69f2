"""rapier2d in double precision: impulse joints, and multibody joints with the loop closed by an impulse joint."""

import re

import native
from machine import Peer, Setting

# Joints, step (s), sweeps of the impulse joints. More solver iterations are equivalent to shorter steps. With joints as stiff as the
# default, the remaining error is due to the first-order step.
RUNS = tuple(
    (joints, h, sweeps) for joints in ("impulse", "multibody") for h in (1e-3, 1e-4, 1e-5, 1e-6) for sweeps in (1, 4)
)


def peer() -> Peer:
    program = native.cargo_built("rapier")
    lock = (native.SOURCES / "rapier" / "Cargo.lock").read_text(encoding="utf-8")
    version = re.search(r'name = "rapier2d-f64"\nversion = "(.+)"', lock)[1]
    return Peer("rapier2d", version, [_setting(native.Program(program, *run), *run) for run in RUNS])


def _setting(program: native.Program, joints: str, step: float, sweeps: int) -> Setting:
    loop = "" if joints == "impulse" else " without damping, loop closed by an impulse joint"
    text = f"f64, {joints} joints{loop}, h = {step:g} s, sweeps = {sweeps}, warm-started, softness by default"
    return Setting(text, program.begin, program.clock)
