"""rapier2d in double precision: impulse joints, and multibody joints with the loop closed by an impulse joint."""

import re

import native
from machine import Peer, Setting

# Joints, step (s), solver iterations (each is a sub-step of its own), sweeps of the joints in each.
RUNS = tuple(("impulse", h, 1, sweeps) for h in (1e-3, 1e-4, 1e-5, 1e-6) for sweeps in (1, 4, 16)) + tuple(
    ("multibody", h, 1, 1) for h in (1e-3, 1e-4, 1e-5, 1e-6)
)


def peer() -> Peer:
    program = native.cargo_built("rapier")
    lock = (native.SOURCES / "rapier" / "Cargo.lock").read_text(encoding="utf-8")
    version = re.search(r'name = "rapier2d-f64"\nversion = "(.+)"', lock)[1]
    return Peer("rapier2d", version, [_setting(native.Program(program, *run), *run) for run in RUNS])


def _setting(program: native.Program, joints: str, step: float, substeps: int, sweeps: int) -> Setting:
    text = f"f64, {joints} joints, h = {step:g} s, {substeps} sub-step, {sweeps} sweeps, joints warm-started, default softness"
    return Setting(text, program.begin, program.clock)
