"""Which processes of a run go first where cores are few: the way from a sample to its estimate is short only if nobody waits for a core.

Broker, machine, twin and watch compute for some tens of microseconds and sleep again. Where the system allows it (root, or a limit for
real-time priorities) they have the lowest of these; elsewhere they ask Linux for short turns, in return for being woken at once. What is
looked at by people, and what looks ahead, is patient.
"""

import contextlib
import ctypes
import os
import platform
from typing import Final

FIRST: Final = ("broker", "machine", "follow", "watch")
LAST: Final = ("forecast", "dashboard")

PATIENCE: Final = 10
"""The niceness of those that come last."""

TURN_NS: Final = 100_000
"""Of those that go first, where there is no real-time priority; Linux's own turns last milliseconds."""

SCHED_SETATTR: Final = {"x86_64": 314, "aarch64": 274}
"""The number of the call, which libraries of C have no name for before glibc 2.41."""


class _Attributes(ctypes.Structure):
    """`struct sched_attr` of Linux, of which an ordinary process has niceness and turn (`sched_runtime`, since Linux 6.12)."""

    _fields_ = (
        *((name, ctypes.c_uint32) for name in ("size", "policy")),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        *((name, ctypes.c_uint64) for name in ("runtime", "deadline", "period")),
    )


def give(pid: int, name: str) -> None:
    """Gives a process that has just been started its place; threads that it makes inherit it. Nothing happens where a system knows no such thing."""
    with contextlib.suppress(OSError):
        if name in LAST and hasattr(os, "setpriority"):
            os.setpriority(os.PRIO_PROCESS, pid, PATIENCE)
        elif name in FIRST and hasattr(os, "sched_setscheduler"):
            try:
                os.sched_setscheduler(pid, os.SCHED_RR, os.sched_param(os.sched_get_priority_min(os.SCHED_RR)))
            except PermissionError:
                _short_turns(pid)


def _short_turns(pid: int) -> None:
    number = SCHED_SETATTR.get(platform.machine())
    if number is not None and platform.system() == "Linux":
        attributes = _Attributes(size=ctypes.sizeof(_Attributes), runtime=TURN_NS)
        # An older kernel does not look at it, or refuses it: then all is as usual.
        ctypes.CDLL(None).syscall(number, pid, ctypes.byref(attributes), 0)
